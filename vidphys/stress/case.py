"""One cell of the matrix, as data: what is run, against which reference, within which bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SOUND, WARNED, REFUSED, SILENT, SKIPPED = "sound", "warned", "refused", "silently wrong", "skipped"
ANY_HONEST = (SOUND, WARNED, REFUSED)


@dataclass(frozen=True)
class Case:
    """A cell.

    Args:
        axis: which extreme is driven, e.g. ``softening``.
        system: what moves, or what is drawn.
        extreme: the setting in words, unique within the axis with the rest.
        value: where it lies on the axis, for the figure.
        run: computes the error against the reference; infinite where there is no right answer.
            A name or a reason that nothing can be run for is a :class:`Skip`.
        bound: largest error of a sound result.
        integrator, dtype, path: of the evaluation.
        figure: id of the reliability figure that the cell belongs to, e.g. ``A12``.
        must: the verdicts that the figure allows.
        home: folder of the package that the part is of, where it is not ours: its clear errors
            are refusals too.
    """

    axis: str
    system: str
    extreme: str
    value: float
    run: Callable[[], float]
    bound: float
    integrator: str = "none"
    dtype: str = "float64"
    path: str = "eager"
    figure: str = ""
    must: tuple[str, ...] = ANY_HONEST
    home: Path | None = None

    @property
    def name(self) -> str:
        """Unique in the matrix."""
        parts = (self.axis, self.system, self.extreme, self.integrator, self.dtype, self.path)
        return "/".join(parts)


class Skip(Exception):  # noqa: N818 (no error: a cell that this machine has no means for)
    """A cell that cannot be run here, and why."""
