"""The reliability figures A1 to A30: what each promises, and what the cells say of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vidphys.stress.case import SKIPPED
from vidphys.stress.verdict import Outcome

PROMISES = {
    "A1": ("order of leapfrog", "2.00 within 0.05"),
    "A2": ("order of the fourth and the eighth order", "declared within 0.15"),
    "A3": ("order of RK4, implicit midpoint and Tao", "declared within 0.1"),
    "A4": ("way back after 2000 and 2000 steps", "1e-11 in float64, 1e-3 in float32"),
    "A5": ("momentum and angular momentum after 2000 steps", "1e-12"),
    "A6": ("Tao's gate over 2000 steps", "1e-4"),
    "A7": ("F(q, -G) = -F(q, G)", "in every bit, in every precision"),
    "A8": ("energy over the long rollout", "1e-6 float64 and flat; 1e-3 float32"),
    "A9": ("growth of rounding with compensated sums", "exponent 0.5 within 0.15"),
    "A10": ("half-precision state", "refused"),
    "A11": ("steps of 0.1 ms to 0.1 s", "error falls; a step above the limit is flagged"),
    "A12": ("softening 1e-1 to 1e-6", "1e-2 or a warning; the option 1e-6"),
    "A13": ("mass ratio to 1e6", "energy within 1e-3"),
    "A14": ("coordinates times 1e-6 to 1e6", "1e-12 float64, 1e-5 float32"),
    "A15": ("none to 10,000 bodies", "forces within 1e-6 (float32 1e-5) in bounded memory"),
    "A16": ("contact stiffness 30 to 1e8", "energy within 5 %, or a warning"),
    "A17": ("gamma dt 1e-3 to 1e3", "the exact decay, no overshoot"),
    "A18": ("temperature 1e-8 to 1e6", "within 3 standard errors"),
    "A19": ("temperature 0", "friction alone, no noise"),
    "A20": ("drive to, at and above the friction", "within 5 %; no steady state is named"),
    "A21": ("negative friction under a guarantee or with heat", "refused"),
    "A22": ("bias of the energy-balance estimator", "1 %, with noise 10 %, or a wide interval"),
    "A23": ("episodes of zero energy", "never infinite"),
    "A24": ("CUDA against CPU, traced and compiled against eager", "forces within 1e-5"),
    "A25": ("one seed twice", "the same bits"),
    "A26": ("first and second gradients", "torch's own tolerances"),
    "A27": ("coincident bodies, touching bodies, identical colours", "finite; refused; warned"),
    "A28": ("images from 1 x 1 to 4096 x 4096", "right, or refused before allocation"),
    "A29": ("black, saturated, grey and noisy frames", "no confident position"),
    "A30": ("NaN or infinity in any input", "refused by name"),
}
MET, PARTLY, MISSED, NOT_MEASURED = "met", "met in part", "missed", "not measured"


@dataclass(frozen=True)
class FigureRow:
    """One figure of the table.

    Args:
        name, promise, bound: as in :data:`PROMISES`.
        measured: the worst cell, its error and bound, in words.
        cells: how many cells it has.
        verdict: ``met``, ``met in part`` where cells were skipped, ``missed`` or ``not
            measured``.
        why: the cells that miss it, or why it is not measured.
    """

    name: str
    promise: str
    bound: str
    measured: str
    cells: int
    verdict: str
    why: str


def figure_rows(outcomes: Sequence[Outcome]) -> list[FigureRow]:
    """The table, one row a figure."""
    return [_row(name, [o for o in outcomes if o.case.figure == name]) for name in PROMISES]


def _row(name: str, cells: list[Outcome]) -> FigureRow:
    promise, bound = PROMISES[name]
    run = [cell for cell in cells if cell.verdict != SKIPPED]
    if not run:
        reasons = {cell.said for cell in cells} or {"no cell in this preset"}
        why = "; ".join(sorted(reasons))
        return FigureRow(name, promise, bound, "", 0, NOT_MEASURED, why)
    wrong = [cell for cell in run if not cell.allowed]
    notes = [f"{cell.case.name}: {cell.verdict} {_number(cell.error)}" for cell in wrong[:5]]
    notes += sorted({f"skipped: {cell.said}" for cell in cells if cell.verdict == SKIPPED})
    verdict = MISSED if wrong else MET if len(run) == len(cells) else PARTLY
    return FigureRow(name, promise, bound, _measured(run), len(run), verdict, "; ".join(notes))


def _measured(cells: list[Outcome]) -> str:
    """Counts of the verdicts, and the sound cell that is nearest to its bound."""
    counts = ", ".join(
        f"{sum(cell.verdict == verdict for cell in cells)} {verdict}"
        for verdict in dict.fromkeys(cell.verdict for cell in cells)
    )
    sound = [c for c in cells if c.verdict == "sound" and c.error is not None and c.case.bound > 0]
    if not sound:
        return counts
    nearest = max(sound, key=lambda cell: (cell.error or 0.0) / cell.case.bound)
    return f"{counts}; nearest to its bound {_number(nearest.error)} of {nearest.case.bound:g}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"
