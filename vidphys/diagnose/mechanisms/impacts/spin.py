"""Balls that spin: a law beside walls that grip them, begun at the impacts that were seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.fit import race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.kernels.walls import SOLID

GRIPS = (0.0, 0.6)  # tangential restitutions that a fit begins with, beside what impacts tell
MOST_GRIP = 0.9
FIRST = 2  # impacts, up to which a fit goes by one at a time


def spun(clips: Sequence[Frames], base: Fit) -> Fit | None:
    """The same law of a ball that spins, if walls strike it in the plane, in one clip.

    Args:
        clips: of the ball.
        base: the law of a ball that does not spin.
    """
    law = base.model.law
    if not law.walls or law.coordinates != 2 or len(clips) > 1 or not clips[0].impacts:
        return None
    # How a wall lies, the first bounce does not tell from what it takes along it; the next do.
    several = _bounces(base) > 1
    walls = tuple(replace(wall, turns=several, smooth=False) for wall in law.walls)
    model = Model(replace(law, walls=walls, spins=True), base.model.charts)
    known = {name: value for name, (value, _) in base.numbers.items()}
    turns = {known.get("turn 1", 0.0), _level(base, known)} if several else {0.0}
    guesses = [g for turn in sorted(turns) for g in _guesses(clips[0], base, model, known, turn)]
    lengths = _lengths(clips[0])
    return max(race(clips, [(model, guesses)], lengths), key=lambda x: x.score, default=None)


def _bounces(base: Fit) -> int:
    """How often the law has the ball bounce off its first wall in the frames of its clip."""
    turn = base.numbers.get("turn 1", (0.0, 0.0))[0]
    rates = base.model.coordinates(base.values, base.clips)[0][:, 1]
    towards = rates @ base.model.law.walls[0].turned(turn) > 0
    return int((towards[:-1] & ~towards[1:]).sum())


def _level(base: Fit, known: Mapping[str, float]) -> float:
    """Radians by which the first wall turns until it is level, as a floor is; or as it is."""
    x, y = base.model.law.walls[0].normal
    force = np.array([known.get("force 1", 0.0), known.get("force 2", 0.0)])
    along, across = force @ [x, y], force @ [-y, x]
    return float(np.arctan2(across, along)) if along > abs(across) else known.get("turn 1", 0.0)


def _guesses(
    clip: Frames, base: Fit, model: Model, known: Mapping[str, float], turn: float
) -> list[np.ndarray]:
    """Numbers and starts with the spin that the first impact tells, for each grip."""
    normal = model.law.walls[0].turned(turn)
    along = np.array([-normal[1], normal[0]])
    changes = [float(x.change @ along) for x in clip.impacts]
    start, speed = base.values[len(known) :], float(clip.impacts[0].before @ along)
    out = []
    for grip in (*_told(changes), *GRIPS):
        slip = -changes[0] * (1 + 1 / SOLID) / (1 + grip)
        share = (slip - speed) / max(float(np.linalg.norm(start[2:])), np.finfo(float).tiny)
        begun = {**known, "turn 1": turn, "turn 2": 0.0, "spin": share}
        begun |= {name: grip for name in model.law.names if name.startswith("grip")}
        out.append(np.concatenate([[begun[name] for name in model.law.names], start]))
    return out


def _told(changes: Sequence[float]) -> list[float]:
    """Each change of the speed along one wall is the last one, turned round and smaller."""
    if len(changes) < 2 or not changes[0]:
        return []
    return [float(np.clip(-changes[1] / changes[0], 0.0, MOST_GRIP))]


def _lengths(clip: Frames) -> list[int]:
    """Frames up to between each impact and the next, and all."""
    times = clip.stretches[0].times
    when = times[[x.frame for x in clip.impacts]]
    between = np.searchsorted(clip.times, 0.5 * (when[:-1] + when[1:])).tolist()
    return [*between[:FIRST], len(clip.times)]
