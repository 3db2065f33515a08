"""Fitting laws to whole recordings by robust least squares, over ever longer beginnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.charts import Arc
from vidphys.diagnose.mechanisms.fitted import Fit, Model, residuals_of
from vidphys.diagnose.mechanisms.frames import Frames, spread_of
from vidphys.diagnose.mechanisms.uncertainty import with_errors

FEWEST = 8  # frames that a fit begins with
PARTS = 12  # of a recording, of which at least one is fitted first
GROWTH = 1.7
LAST, ON_THE_WAY = 40, 20  # steps of a fit to all frames, and to some
MANY = 4  # clips, each with a start of its own, from which fewer steps are made
TRIED = 2  # of several guesses, those that begin nearest
BEHIND = 25.0  # times the best law's cost, from which another one is dropped
HELD = 0.003  # of the spread: what moving a wall by a spread costs, or a view by what is usual
SPUN = 0.03  # of the spread: what a bounce costs that leaves more speed along the wall, by its own
UNUSUAL = 4.0  # times what is usual, from which a view is drawn back: no plane is seen edge on
TINY = 1e-4  # of SOFT squared: the cost of a frame below which no law is dropped
STEEP = 4.0  # tangent of an arc's slant, from which it is no law, and drops none
SETTLED = 2.0  # times a frame's cost so far, up to which a law foretold the frames that are new
MOST = 1e6  # times the spread, by which a law that flew apart counts as missing a frame
PURE = ("restitution", "along", "grip", "spin", "turn ", "mass", "rub", "steeper")  # of no unit
NUDGE = 1.5e-8  # over the size of a number, for derivatives
SOFT = 0.03  # of the spread: errors beyond count by their size while a fit begins


def fit(clips: Sequence[Frames], model: Model, guess: np.ndarray) -> Fit | None:
    """Fit a law to all frames from numbers that are nearly right; ``None`` where it fails."""
    tries = LAST if len(clips) < MANY else ON_THE_WAY
    found = _least_squares(clips, model, guess, spread_of(clips), tries)
    return None if found is None else with_errors(list(clips), model, found.x, spread_of(clips))


def without_friction(clips: Sequence[Frames], base: Fit) -> Fit | None:
    """The same law without the friction that goes with the speed, from its numbers on."""
    at = base.model.law.names.index("linear")
    law = replace(base.model.law, friction="none")
    return fit(clips, Model(law, base.model.charts), np.delete(base.values, at))


def race(
    clips: Sequence[Frames],
    runners: Sequence[tuple[Model, Sequence[np.ndarray]]],
    lengths: Sequence[int] = (),
) -> list[Fit]:
    """Fit several laws over ever longer beginnings of the recording, and drop those that fall back.

    A rate that is guessed is not yet right over many swings, so a fit begins with few frames.

    Args:
        clips: what was seen.
        runners: laws with guesses: the law's numbers, then the starts of all clips.
        lengths: frames of those beginnings; ever longer by a share where not given.
    """
    scale = spread_of(clips)
    running = [(model, guesses, guesses, 0.0) for model, guesses in runners]
    longest = max(len(c.times) for c in clips)
    for count in lengths or _lengths(longest):
        part = [clip.upto(count) for clip in clips]
        tries = LAST if count == longest else ON_THE_WAY
        ended = []
        for model, guesses, first, a_frame in running:
            near = np.argsort(_costs(part, model, np.stack(guesses), scale), kind="stable")
            good: list[OptimizeResult] = []
            for guess in [guesses[i] for i in near[:TRIED]]:
                found = _least_squares(part, model, guess, scale, tries)
                good += [] if found is None else [found]
                if found is not None and found.cost <= SETTLED * a_frame * count:
                    break
            if good:
                best = min(good, key=lambda x: x.cost)
                ended.append((float(best.cost), model, best.x, first))
        if not ended:
            return []
        true = [
            cost
            for cost, model, x, _ in ended
            if not _steep(model, residuals_of(part, model, x)[1])
        ]
        most = BEHIND * max(min(true, default=np.inf), count * SOFT**2 * TINY)
        # The first guesses stay in the race: what few frames bent may be better as it was.
        running = [
            (model, [x, *first], first, cost / count)
            for cost, model, x, first in ended
            if cost <= most
        ]
    unwalled = {_open(model): cost / count for cost, model, *_ in ended if not model.law.walls}
    fits = [
        with_errors(list(clips), model, x[0], scale)
        for model, x, _, a_frame in running
        # Walls that explain nothing cost numbers, and every law after them the time to fit it.
        if not model.law.walls or a_frame < unwalled.get(_open(model), np.inf)
    ]
    return [x for x in fits if x is not None and not _steep(x.model, x.geometry)]


def with_friction_or_none(
    clips: Sequence[Frames], runners: Sequence[tuple[Model, Sequence[np.ndarray]]]
) -> list[Fit]:
    """:func:`race` of laws with a friction that goes with the speed; and what wins without it."""
    found = race(clips, runners)
    return found + [x for x in (without_friction(clips, one) for one in found) if x is not None]


def _steep(model: Model, geometry: Sequence[np.ndarray]) -> bool:
    """Whether an arc is seen so steeply that it shows whatever moves on a line."""
    each = zip(model.charts, geometry, strict=True)
    return any(isinstance(c, Arc) and c.aslant and c.slant(g) > STEEP for c, g in each)


def _open(model: Model) -> Model:
    """The same without walls."""
    return Model(replace(model.law, walls=()), model.charts)


def _lengths(frames: int) -> list[int]:
    """How many frames are fitted, one after the other."""
    counts, count = [], max(2 * FEWEST, frames // PARTS)
    while count < frames:
        counts.append(count)
        count = int(GROWTH * count)
    return [*counts, frames]


def _missing(clips: Sequence[Frames], model: Model, values: np.ndarray, scale: float) -> np.ndarray:
    lead = values.shape[:-1]
    parts = [r.reshape(*lead, -1) for r in residuals_of(clips, model, values)[0]]
    joined = np.concatenate(parts, -1) / scale
    return np.fmin(np.fmax(joined, -MOST), MOST)  # what is no number counts as one of them


def _held(model: Model, count: int, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """What holds numbers at their guess that frames may say nothing of: of walls, meetings, views.

    Args:
        count: numbers in all.

    Returns:
        By how much, and how far from it they are drawn back ever more: those of views alone.
    """
    held, far = np.zeros(count), np.full(count, np.inf)
    for i, name in enumerate(model.law.names):
        if name.startswith(("wall", "reach")):
            held[i] = HELD / (1.0 if model.charts[0].name in ("arc", "angle") else scale)
        elif name.startswith(PURE):
            held[i] = HELD
        elif name in view.NAMES:
            usual = view.USUAL[view.NAMES.index(name)]
            held[i], far[i] = HELD / usual, UNUSUAL * usual
    return held, far


def _costs(clips: Sequence[Frames], model: Model, values: np.ndarray, scale: float) -> np.ndarray:
    """Of many guesses ``(b, v)``, each."""
    left = _missing(clips, model, values, scale) / SOFT
    return (SOFT**2 * (np.sqrt(1 + left**2) - 1)).sum(-1)


def _least_squares(
    clips: Sequence[Frames], model: Model, guess: np.ndarray, scale: float, tries: int
) -> OptimizeResult | None:
    held, far = _held(model, len(guess), scale)
    usual = model.slowness(clips, len(guess))
    along = [i for i, name in enumerate(model.law.names) if name.startswith("along")]

    def left(values: np.ndarray) -> np.ndarray:
        moved = values - guess
        drawn_back = held * moved * (1 + (moved / far) ** 2)
        sped_up = SPUN * np.maximum(np.abs(values[..., along]) - 1, 0)
        return np.concatenate([_missing(clips, model, values, scale), drawn_back, sped_up], -1)

    def slopes(values: np.ndarray) -> np.ndarray:
        near = values + np.diag(NUDGE * np.maximum(np.abs(values), usual))
        first, *rest = left(np.concatenate([values[None], near]))
        return (np.array(rest) - first).T / (near - values).diagonal()

    try:
        found = least_squares(
            left,
            guess,
            slopes,
            loss="soft_l1",
            f_scale=SOFT,
            x_scale="jac",
            max_nfev=tries,
            xtol=1e-7,
            ftol=1e-7,
        )
    except (ValueError, np.linalg.LinAlgError):
        return None
    return found if np.isfinite(found.x).all() else None
