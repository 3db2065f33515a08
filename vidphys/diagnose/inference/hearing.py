"""Rival structures, each judged along the paths that it gives itself.

The regression that ranks every combination reads them all along one model's paths, and so favours
that model: of two shapes of a force the wrong one may lead by hundreds of log likelihood along its
own paths, and lose where each has its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.inference.menu import BETWEEN, PAIR, POWERS, SHAPES, field_of, pair_term
from vidphys.diagnose.inference.refine import Fitted, refine
from vidphys.diagnose.inference.structures import Structure, is_wrong, price
from vidphys.diagnose.weak.paths import Paths
from vidphys.diagnose.weak.windows import Windows

HEARD = 6  # structures, of different terms or shapes, beside the best of each shape
FEW, LEAST = 128, 4  # frames and windows, about and at least, that are tried before all of them
HOPELESS = 1.0  # of log likelihood behind for each coordinate; own paths make good a fifth at most
NEAR = 15.0  # of log likelihood behind the best in these, up to which a structure stays

SOFT = 0.1  # of the usual distance, where no length is seen to soften a force

Key = tuple[frozenset[str], str]


def key_of(structure: Structure) -> Key:
    """What structures differ in, but for the lengths of their forces."""
    pair = structure.term(PAIR)
    return structure.kinds, "" if pair is None else pair.shape


@dataclass(frozen=True)
class Heard:
    """A structure that was fitted along its own paths.

    Args:
        score: on the scale of :class:`Structure` but for one constant.
        key: what it was before the fit, see :func:`key_of`.
        fitted: its numbers and paths.
    """

    score: float
    key: Key
    fitted: Fitted


def heard(
    windows: Windows, paths: Paths, structures: Sequence[Structure], ratio: float, floor: float
) -> list[Heard]:
    """The likeliest structures, each fitted to the frames along its own paths, best first.

    Args:
        windows: what was recorded.
        paths: a first guess of them all.
        structures: best first, of which one of each key is fitted.
        ratio: variance of random kicks per second over that of the noise.
        floor: standard deviation below which a residual is numerical, world units.
    """
    behind = HOPELESS * windows.seen.sum() * windows.frames.shape[-1]
    asked = _asked([s for s in structures if s.score > structures[0].score - behind])
    enough = max(LEAST, FEW // windows.frames.shape[1])
    few = np.arange(0, len(windows), max(1, len(windows) // enough))
    if len(few) < len(windows):
        rough = _fits(windows.only(few), paths.only(few), asked, ratio, floor)
        best = max((x.score for x in rough), default=0.0)
        asked = [x.fitted.structure for x in rough if x.score > best - NEAR]
    return sorted(_fits(windows, paths, asked, ratio, floor), key=lambda x: -x.score)


def between_powers(windows: Windows, fitted: Fitted, ratio: float, floor: float) -> bool:
    """Whether a pair force alone, by a power of the distance between whole ones, is as likely.

    A whole power with a weak trap or friction beside it makes up for such a one.

    Args:
        windows: what was recorded.
        fitted: of the answer.
        ratio, floor: see :func:`heard`.
    """
    pair = fitted.structure.term(PAIR)
    if pair is None or pair.shape not in POWERS or (len(fitted.structure.terms) == 1 and not ratio):
        return False
    distance = field_of(windows, fitted.paths).distance
    usual = float(np.median(distance[np.isfinite(distance)]))
    scale = pair.scale or SOFT * usual
    pull = float(fitted.structure.of(pair)[0]) * SHAPES[pair.shape](np.array(usual), scale)
    rivals = [
        Structure(
            (pair_term(shape, scale, pair.source),),
            np.array([pull / SHAPES[shape](np.array(usual), scale)]),
            0.0,
            0.0,
        )
        for shape in BETWEEN
    ]
    own = _score(fitted, floor)
    return any(x.score > own - NEAR for x in _fits(windows, fitted.paths, rivals, ratio, floor))


def _fits(
    windows: Windows, paths: Paths, structures: Sequence[Structure], ratio: float, floor: float
) -> list[Heard]:
    found = []
    for structure in structures:
        try:
            fitted = refine(windows, paths, structure, ratio)
        except (FloatingPointError, np.linalg.LinAlgError):
            continue
        if not is_wrong(fitted.structure):
            found.append(Heard(_score(fitted, floor), key_of(structure), fitted))
    return found


def _asked(structures: Sequence[Structure]) -> list[Structure]:
    """The best of each shape of a pair force, and some more."""
    by_shape: dict[str, Structure] = {}
    by_key: dict[Key, Structure] = {}
    for structure in structures:
        by_shape.setdefault(key_of(structure)[1], structure)
        if len(by_key) < HEARD:
            by_key.setdefault(key_of(structure), structure)
    return list({key_of(s): s for s in (*by_key.values(), *by_shape.values())}.values())


def _score(fitted: Fitted, floor: float) -> float:
    rows = fitted.freedom + len(fitted.values)
    squares = fitted.variance * fitted.freedom
    variance = max(squares / rows, floor**2)
    likelihood = float(-0.5 * (squares / variance + rows * np.log(variance)))
    return likelihood - price(rows, fitted.structure.numbers)


def reweighed(structures: Sequence[Structure], fits: Sequence[Heard]) -> list[Structure]:
    """Structures ranked by one regression, with the differences of score of those that were heard.

    Args:
        structures: best first.
        fits: of some of them, best first.
    """
    tops: dict[Key, float] = {}
    for structure in structures:
        tops.setdefault(key_of(structure), structure.score)
    if fits[0].key not in tops:
        return list(structures)
    best = tops[fits[0].key]
    moved = {x.key: best + x.score - fits[0].score - tops[x.key] for x in fits if x.key in tops}
    scored = [replace(s, score=s.score + moved.get(key_of(s), 0.0)) for s in structures]
    return sorted(scored, key=lambda s: -s.score)
