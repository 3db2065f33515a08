"""One clip's answer held to its truth."""

from __future__ import annotations

import json
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.optimize import linear_sum_assignment

from vidphys.diagnose.explanations.forecast import last_seen
from vidphys.experiments.filmed.answers import (
    ALIKE,
    EXPLAINED,
    NAMES,
    NOT,
    Answer,
    ask,
    told,
)
from vidphys.experiments.filmed.byhand import forecast_by_hand
from vidphys.experiments.filmed.folder import CLIP, TRUTH
from vidphys.experiments.filmed.truth import Truth
from vidphys.runs.atomic import write_json

SCORE = "score.json"
FOLLOWED = 0.01  # of the picture's height, root mean square
SEEN = 0.7  # share of the frames in which a body that is followed is seen
SAME_TIME = 2e-3  # seconds


@dataclass(frozen=True)
class NumberScore:
    """A number of the truth beside what was told; ``None`` where nothing was.

    A number that the product has, but of which it says that the clip does not tell it, is
    ``refused``: it has no value here, and no part in errors and biases.
    """

    name: str
    body: int | None
    truth: float
    value: float | None
    half: float | None
    refused: bool = False

    @property
    def error(self) -> float | None:
        """Relative, with its sign."""
        return None if self.value is None else self.value / self.truth - 1

    @property
    def inside(self) -> bool | None:
        """Whether the 95 % interval holds the truth."""
        if self.value is None or self.half is None:
            return None
        return abs(self.value - self.truth) <= self.half


@dataclass(frozen=True)
class Score:
    """What became of a clip.

    Args:
        kind, part: of the truth.
        misses: root mean square distance of each body's nearest track from a point of the body,
            over the picture's height; ``None`` where none follows it.
        kinds, status, why: of the answer.
        exact: whether precisely the right terms are named.
        numbers: see :class:`NumberScore`.
        forecast: error over the last frames of the model, of persistence from where the bodies
            were, of ``staying`` where they were followed last, and by hand, pixels.
        seconds: that the answer took.
        stays: of the answer.
    """

    kind: str
    part: str
    misses: tuple[float | None, ...]
    kinds: tuple[str, ...]
    status: str
    why: str
    exact: bool
    numbers: tuple[NumberScore, ...]
    forecast: dict[str, float]
    seconds: float
    stays: bool = False

    @property
    def followed(self) -> bool:
        return all(miss is not None and miss <= FOLLOWED for miss in self.misses)

    @property
    def claimed(self) -> bool:
        """Whether it is at least mostly explained."""
        return self.status != NOT

    @property
    def wrong_and_sure(self) -> bool:
        return self.status == EXPLAINED and not self.exact

    def write(self, path: Path) -> None:
        """As JSON."""
        write_json(path, asdict(self))

    @classmethod
    def read(cls, path: Path) -> Self:
        """From JSON."""
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        data["numbers"] = tuple(NumberScore(**number) for number in data["numbers"])
        return cls(**{**data, "misses": tuple(data["misses"]), "kinds": tuple(data["kinds"])})


def score_clip(folder: Path) -> Score:
    """Ask the product about a filmed clip, unless that was done; kept beside the clip."""
    path = folder / SCORE
    if not path.exists():
        truth = Truth.read(folder / TRUTH)
        score(truth, ask(folder / CLIP, truth.size, truth.ruler)).write(path)
    return Score.read(path)


def score(truth: Truth, found: Answer) -> Score:
    """Hold an answer to the truth."""
    track, misses, order = matched(truth, found.track)
    right = frozenset(ALIKE.get(kind, kind) for kind in truth.structure)
    return Score(
        truth.kind,
        truth.part,
        misses,
        tuple(sorted(found.kinds)),
        found.status,
        found.why,
        found.kinds == right,
        _numbers(truth, found, order),
        _forecasts(truth, found, track, order),
        found.seconds,
        found.stays,
    )


def matched(
    truth: Truth, track: np.ndarray
) -> tuple[np.ndarray, tuple[float | None, ...], dict[int, int]]:
    """Which track follows which body.

    Returns:
        The tracks in the truth's order, NaN where a body has none; what each is off by, over the
        picture's height; and the track of each body.
    """
    bodies, free = truth.steady.shape[1], truth.times >= truth.released
    ordered = np.full(truth.steady.shape, np.nan)
    misses: list[float | None] = [None] * bodies
    order: dict[int, int] = {}
    if len(track) != len(truth.times):
        return ordered, tuple(misses), order
    off = track[free][:, None] - truth.steady[free][:, :, None]
    squares = ((off - _middle(off, truth.radii[:, None])) ** 2).sum(-1)
    share = np.isfinite(squares).mean(0)
    count = np.maximum(np.isfinite(squares).sum(0), 1)
    apart = np.where(share >= SEEN, np.sqrt(np.nansum(squares, 0) / count), np.inf)
    cost = np.where(np.isfinite(apart), apart, 1e9)
    for body, follower in zip(*linear_sum_assignment(cost), strict=True):
        if np.isfinite(apart[body, follower]):
            misses[body] = float(apart[body, follower] / truth.size[0])
            order[int(body)] = int(follower)
            ordered[:, body] = track[:, follower]
    return ordered, tuple(misses), order


def _point(truth: Truth, ordered: np.ndarray) -> np.ndarray:
    """Which point of each body its track follows, from the middle, ``(n, 2)``."""
    return _middle((ordered - truth.steady)[truth.times >= truth.released], truth.radii)


def _middle(off: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """What tracks ``(t, …, 2)`` are usually off by, where that lies within the body; else 0.

    A body has no place but a middle: any point of it may be followed, if it is always the same.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a body that is never seen
        middle = np.nanmedian(off, 0)
    within = np.sqrt((middle**2).sum(-1)) < radii
    return np.where(within[..., None], middle, 0.0)


def _numbers(truth: Truth, found: Answer, order: dict[int, int]) -> tuple[NumberScore, ...]:
    scores = []
    for number in truth.numbers:
        if number.name not in NAMES or (number.name == "g" and "uniform" not in truth.structure):
            continue
        body = order.get(number.body or 0)
        said = None
        for group in found.mechanism:
            if body is not None and body in group["bodies"]:
                said = told(group, number.name, body)
        refused = said is not None and not said.known
        value, half = (None, None) if said is None or refused else (said.value, said.half)
        if number.name == "mass_ratio" and value and half is not None and order.get(1) == 0:
            value, half = 1 / value, half / value**2  # the product's first body is the second
        scores.append(NumberScore(number.name, number.body, number.value, value, half, refused))
    return tuple(scores)


def _forecasts(
    truth: Truth, found: Answer, track: np.ndarray, order: dict[int, int]
) -> dict[str, float]:
    """Errors in pixels over the frames that nothing was fitted to, of bodies that were followed."""
    if found.forecast is None or not order:
        return {}
    times, places = found.forecast
    frames = np.array([int(np.argmin(np.abs(truth.stamps - t))) for t in times])
    near = np.abs(truth.stamps[frames] - times) < SAME_TIME
    frames, places = frames[near], places[near]
    if not len(frames) or places.shape[1] <= max(order.values()):
        return {}
    bodies = sorted(order)
    point = _point(truth, track)[bodies]
    seen = truth.steady[frames][:, bodies] + point
    fitted = np.arange(len(truth.times)) < frames[0]
    before = truth.steady[frames[0] - 1, bodies] + point
    last = last_seen(track[: frames[0], bodies], before)
    by_hand = forecast_by_hand(truth, track, fitted)[frames][:, bodies]
    paths = {
        "model": places[:, [order[body] for body in bodies]],
        "persistence": np.broadcast_to(before, seen.shape),
        "staying": np.broadcast_to(last, seen.shape),
        "by hand": by_hand,
    }
    errors = {name: float(np.sqrt(((p - seen) ** 2).sum(-1).mean())) for name, p in paths.items()}
    return {name: error for name, error in errors.items() if np.isfinite(error)}
