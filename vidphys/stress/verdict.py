"""Running a cell and judging it: an error beyond its bound must have been warned of, or refused."""

from __future__ import annotations

import math
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

from dynamics import DynamicsWarning
from vidphys.stress.case import REFUSED, SILENT, SKIPPED, SOUND, WARNED, Case, Skip

HOME = Path(__file__).resolve().parents[2]
CLEAR = (ValueError, NotImplementedError)  # raised by torch as well: where from is looked at
STAGES = ("dynamics", "renderers", "encoders", "binders", "readouts", "vidphys")


@dataclass(frozen=True)
class Outcome:
    """What became of a cell.

    Args:
        case: the cell.
        verdict: see :mod:`vidphys.stress.case`.
        error: against the reference; ``None`` where nothing was returned or it is not finite.
        said: the warnings' names, or the error message.
        seconds: of the process' own time.
    """

    case: Case
    verdict: str
    error: float | None
    said: str
    seconds: float

    @property
    def allowed(self) -> bool:
        """Whether it is what its reliability figure asks for."""
        return self.verdict in (*self.case.must, SKIPPED)


def judge(case: Case) -> Outcome:
    """Run a cell; any exception that is not a clear refusal counts as silently wrong."""
    began = time.process_time()
    error, verdict = None, ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            error = float(case.run())
        except Skip as reason:
            verdict, said = SKIPPED, str(reason)
        except Exception as failure:  # noqa: BLE001 (a cell must not end the matrix)
            verdict = REFUSED if is_clear(failure, case.home) else SILENT
            said = f"{type(failure).__name__}: {failure}"
    if error is not None:
        names = {w.category.__name__ for w in caught if issubclass(w.category, DynamicsWarning)}
        said = ", ".join(sorted(names))
        verdict = SOUND if error <= case.bound else WARNED if names else SILENT
        error = error if math.isfinite(error) else None
    return Outcome(case, verdict, error, said[:300], time.process_time() - began)


def is_clear(failure: Exception, home: Path | None = None) -> bool:
    """Whether our code, or the part's own package, refused with a sentence: no library stumbled."""
    last = Path(traceback.extract_tb(failure.__traceback__)[-1].filename).resolve()
    homes = [HOME / stage for stage in STAGES] + ([] if home is None else [home])
    ours = any(last.is_relative_to(folder) for folder in homes)
    stress = last.is_relative_to(HOME / "vidphys" / "stress")
    kinds = (*CLEAR, RuntimeError)
    return ours and not stress and isinstance(failure, kinds) and len(str(failure)) > 20
