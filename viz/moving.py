"""One episode that moves in the report: the head answers, its twin does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from viz.sentences import law, verdicts
from viz.showcase import Arrays, read_showcase, zoom_extent
from viz.summary import TWIN, Records
from viz.tables import HOLDS

DIGITS = 3  # of a place, world units
LEAST_SHOWN = 0.6  # seconds after the change at which the first picture stands


def moving_pair(run: Path, records: Records) -> dict[str, Any] | None:
    """Places of both and of the truth under the changed law, if a run has such an episode.

    The last rung of the ladder on which the factored head answers is shown: there pictures, not
    states, are what is seen.
    """
    for line, word, _ in reversed(verdicts(records)):
        if word != HOLDS or line.head != "factored":
            continue
        files = [
            run / "showcase" / f"{line.grounding}-{head}.safetensors" for head in (line.head, TWIN)
        ]
        if all(file.is_file() for file in files):
            head, twin = (read_showcase(file)[0] for file in files)
            mine, its = (arrays["counterfactual_truth"] for arrays in (head, twin))
            if not np.array_equal(mine, its, equal_nan=True):
                continue
            return _told(line.grounding, head, twin, law(records.coupling))
    return None


def _told(rung: str, head: Arrays, twin: Arrays, said: str) -> dict[str, Any]:
    times = np.asarray(head["times"])
    after = times >= 0
    sides = [
        {"title": f"{rung} / {name}", "path": _places(arrays["counterfactual"][after])}
        for name, arrays in (("factored", head), (TWIN, twin))
    ]
    return {
        "caption": f"The same start under {said}, which neither has seen.",
        "extent": round(zoom_extent(head), DIGITS),
        "truth": _places(head["counterfactual_truth"][after]),
        "sides": sides,
        "start": int(np.searchsorted(times[after], min(LEAST_SHOWN, times[-1]))),
    }


def _places(path: np.ndarray) -> list[list[list[float]]]:
    """Rounded, until it is no longer finite."""
    finite = np.isfinite(path).all((1, 2))
    end = len(path) if finite.all() else int(np.argmin(finite))
    return np.round(np.asarray(path[:end], np.float64), DIGITS).tolist()
