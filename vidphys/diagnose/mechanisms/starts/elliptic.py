"""A body that is pulled back to a place, one way harder than another, as by two springs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.charts import Turned
from vidphys.diagnose.mechanisms.fit import with_friction_or_none
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import (
    Local,
    frequency,
    halves,
    joined,
    seen_in,
    start_of,
)

FLAT = 2  # dimensions of the plane
TWICE = 0.05  # of 2: within it the rates of both ways are those of a body on an arc


def elliptic(clips: Sequence[Frames]) -> list[Fit]:
    """Laws of a body that swings along two axes, at a rate of its own along each, best first.

    Args:
        clips: of the body.
    """
    places = [clip.stretches[0].places for clip in clips]
    if places[0].shape[1] != FLAT or clips[0].inputs is not None:
        return []
    seen = [seen_in(clips, places, half) for half in halves(clips)]
    along = min((_axis(one) for one in seen), key=lambda x: x[1])[0]
    model = Model(Law(FLAT, "trap", "linear", apart=True), (Turned(along),))
    begun = [guess for one in seen for guess in _begun(one, model)]
    fits = with_friction_or_none(clips, [(model, begun)])
    return sorted((x for x in fits if not _on_an_arc(x)), key=lambda x: -x.score)


def _axis(seen: Sequence[Local]) -> tuple[tuple[float, float], float]:
    """The one that is pulled least, by least squares, and the share of accelerations missed."""
    s, v, a = joined(seen, "sva")
    one, none = np.ones(len(s)), np.zeros(len(s))
    x, y = s.T
    design = np.concatenate(
        [
            np.column_stack([-x, -y, none, one, none, -v[:, 0]]),
            np.column_stack([none, -x, -y, none, one, -v[:, 1]]),
        ]
    )
    told = a.T.ravel()
    found = np.linalg.lstsq(design, told, rcond=None)[0]
    axes = np.linalg.eigh([found[:2], found[1:3]])[1]
    return (float(axes[0, 0]), float(axes[1, 0])), float((design @ found - told).var() / told.var())


def _begun(seen: Sequence[Local], model: Model) -> list[np.ndarray]:
    """The law's numbers and the starts, with the stiffness that each axis' spectrum tells."""
    (chart,) = model.charts
    assert isinstance(chart, Turned)
    parts = [replace(x, **{n: getattr(x, n) @ chart.axes.T for n in "sva"}) for x in seen]
    each = [[replace(x, s=x.s[:, [i]]) for x in parts] for i in range(FLAT)]
    stiffness = np.array([(2 * np.pi * frequency(x)) ** 2 for x in each])
    centre = np.concatenate([x.s for x in parts]).mean(0)
    return [np.concatenate([stiffness, stiffness * centre, [0.0], *map(start_of, parts)])]


def _on_an_arc(found: Fit) -> bool:
    """Whether a body goes across at twice the rate at which it goes along, as on an arc."""
    one, two = sorted(abs(found.numbers[f"stiffness {i + 1}"][0]) for i in range(FLAT))
    return bool(abs(np.sqrt(two / one) - 2) < TWICE * 2)
