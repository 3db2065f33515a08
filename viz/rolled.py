"""The recording of one episode that was played: the model beside its truth and its twin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from viz.layout import rolled_layout
from viz.overlay import energy_range
from viz.story import ROLLED
from viz.tape import COLOURS, Tape

NAMES = {
    "truth": "the truth",
    "held": "the law that held",
    "model": "the model",
    "twin": "the twin",
    "own": "the model's own, begun at the true one",
}
INNER = 97  # per cent of all places that the picture holds: what runs away is not looked at


@dataclass
class Rolled:
    """What one episode became.

    Args:
        ways: of ``model``, ``truth``, ``held`` and ``twin``, each that is there: times ``(t,)`` in
            seconds and places ``(t, n, 2)``, y upwards.
        energies: of ``model``, ``truth`` and ``own``: times and values ``(t,)``.
        marks: what happens at an instant (seconds), in words.
    """

    ways: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    energies: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    marks: dict[float, str] = field(default_factory=dict)


def write_rolled_recording(rolled: Rolled, meta: Mapping[str, str], path: Path) -> None:
    """Write the recording of one episode.

    Args:
        rolled: the episode; what is not finite is left blank.
        meta: what is shown, in words; ``cell`` becomes the recording's name.
        path: the ``.rrd`` to write, replaced as a whole or not at all.

    Raises:
        ValueError: there is no way of a model.
    """
    if "model" not in rolled.ways:
        raise ValueError("rolled: there must be a way of the model")
    times, _ = rolled.ways["model"]
    shown = {f"world/{role}": NAMES[role] for role in NAMES if role in rolled.ways}
    tape = Tape(meta, float(np.median(np.diff(times))), NAMES, shown)
    tape.turn_upright("world")
    centre, half = _square(rolled)
    roles = [role for role in ("truth", "held", "twin", "model") if role in rolled.ways]
    for way in roles:
        radius = half * (0.03 if way in ("truth", "held") else 0.018)
        tape.bodies(f"world/{way}", *rolled.ways[way], [COLOURS[way]], radius)
    for role, (when, values) in rolled.energies.items():
        tape.series(f"energy/{role}", when, values, role)
    tape.phases(dict(sorted({float(times[0]): ROLLED, **rolled.marks}.items())))
    energies = [values[np.isfinite(values)] for _, values in rolled.energies.values()]
    every = np.concatenate([np.zeros(0), *energies])
    ends = energy_range(float(every.min()), float(every.max())) if len(every) else None
    tape.save(path, rolled_layout(roles, centre, half, float(times[-1]), ends))


def _square(rolled: Rolled) -> tuple[tuple[float, float], float]:
    """Middle and half a side of the square that holds the model's way and the truth's."""
    shown = [places for role, (_, places) in rolled.ways.items() if role != "twin"]
    places = np.concatenate([p.reshape(-1, 2) for p in shown])
    places = places[np.isfinite(places).all(1)]
    if not len(places):
        return (0.0, 0.0), 1.0
    low, high = np.percentile(places, [100 - INNER, INNER], axis=0)
    x, y = (low + high) / 2
    return (float(x), float(y)), max(0.6 * float((high - low).max()), 1e-6)
