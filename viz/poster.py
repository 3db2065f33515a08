"""What stands on the viewer's page until the viewer is there: a still, and what is said of it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from viz.overlay import contact_sheet
from viz.page import inline_png
from viz.showcase import read_showcase
from viz.story import story

TELLING = 0.6  # seconds of a rollout after which its trails show which way it goes


def poster(run: Path, recording: Path) -> dict[str, Any]:
    """What :func:`viz.served.serving` is told of a recording; nothing but its name without arrays.

    Args:
        run: the folder, whose records say how the cell did.
        recording: its ``.rrd``, or its showcase.

    Raises:
        ValueError: its showcase is damaged.
    """
    arrays = run / "showcase" / f"{recording.stem}.safetensors"
    if not arrays.is_file():
        return {"title": recording.stem, "told": {}, "picture": None, "at": None}
    showcase, about = read_showcase(arrays)
    told = story(run, about)
    title = told.pop("cell", recording.stem)
    told.pop("coupling", None)  # the law that was asked says it
    held = io.BytesIO()
    contact_sheet(showcase, {}).savefig(held, format="png", dpi=80)
    return {
        "title": title,
        "told": told,
        "picture": inline_png(
            held.getvalue(), f"An episode of {title}: both laws and energies"
        ).content,
        "at": min(TELLING, float(showcase["times"][-1])),
    }
