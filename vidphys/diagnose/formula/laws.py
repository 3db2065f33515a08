"""The law of a motion along one coordinate: first a smooth one, then one in closed form."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from vidphys.diagnose.formula.formula import STRANGE, Verdict, chosen, clear
from vidphys.diagnose.formula.refusal import ELSE, FEW, would_tell
from vidphys.diagnose.formula.rolled import Rolled, braked, rolled_along
from vidphys.diagnose.formula.search import search
from vidphys.diagnose.formula.springs import Spring, find_spring
from vidphys.diagnose.formula.sums import Samples, Sum
from vidphys.diagnose.recordings.motion import Motion
from vidphys.errors import InputError
from vidphys.progress import Progress

TRIED = 60  # formulas that are rolled
SHORTENED = 12  # of them that are tried without words that do not count
BRAKED = 4  # of them that are tried with every friction
PLACES = 48  # at which the smooth force is read
COARSE = 3e-3  # of the force's spread: what splines may miss of a formula
SECONDS = 20.0  # of one processor, that a search may last
LATE = f"the search took longer than {SECONDS:.0f} s; a shorter recording would tell"
MOST = 4  # numbers of a formula that is told
SURE = 2e-3  # of the force's spread: to within which a number of it is known
AMPLE = 1.5  # times a formula's numbers, that must be known of a smooth force
SLIGHT = 5.0  # nats within which another friction may be the true one


@dataclass(frozen=True)
class FoundLaw:
    """What was found of a motion along one coordinate.

    Args:
        verdict: the formula of its force, or why there is none.
        text: the law as it is read, or the reason and which recording would tell.
        best: the formula that rolls best; ``None`` where none does.
        frictions: names of those that may be the true one, the likeliest first.
        spring: the smooth law behind it; ``None`` where not even that is found.
    """

    verdict: Verdict
    text: str
    best: Rolled | None = None
    frictions: tuple[str, ...] = ()
    spring: Spring | None = None


def law_of(motion: Motion, progress: Progress | None = None) -> FoundLaw:
    """The law of one body along a line, or of two by the distance between them.

    Args:
        motion: of one coordinate; of two bodies their difference is looked at, whose sign must
            not change.
        progress: called after each of four stages.

    Raises:
        InputError: other motions.
    """
    if motion.space != 1 or motion.bodies > 2:
        raise InputError(
            f"law_of: needs one coordinate, or two bodies on a line; got {motion.bodies} bodies in "
            f"{motion.space} dimensions"
        )
    if motion.bodies == 1:
        return coordinate_law(motion.positions[:, :, 0, 0], motion.times, progress=progress)
    apart = motion.positions[:, :, 1, 0] - motion.positions[:, :, 0, 0]
    sign = np.sign(np.nanmedian(apart))
    if np.nanmin(sign * apart) <= 0:
        raise InputError("law_of: the two bodies pass each other; a force along their line jumps")
    return coordinate_law(sign * apart, motion.times, "r", progress)


def coordinate_law(
    x: np.ndarray, times: np.ndarray, variable: str = "x", progress: Progress | None = None
) -> FoundLaw:
    """The law x'' = f(x) + g(v) of a coordinate, or f(x) + (a + b x + c x^2) v.

    Args:
        x: places ``(clips, frames)``, NaN where not seen.
        times: seconds ``(clips, frames)``.
        variable: its name.
        progress: called after each of four stages.
    """
    report = progress or (lambda *_: None)
    spring = find_spring(x, times)
    until = time.thread_time() + SECONDS
    report(1, 4, 0.0)
    if spring is None:
        return FoundLaw(Verdict(None, "no formula"), f"no formula: {ELSE}")
    sums = search(samples_of(spring))
    report(2, 4, 0.0)
    found = _rolled(sums[:TRIED], spring, until)
    found = sorted([*found, *_shortened(found, until)], key=lambda each: each.score)
    report(3, 4, 0.0)
    found += _braked(found[:BRAKED], until)
    report(4, 4, 0.0)
    if time.thread_time() > until:
        return FoundLaw(Verdict(None, "no formula"), f"no formula: {LATE}", spring=spring)
    if not found:
        verdict = Verdict(None, "no formula: none of the grammar rolls along the recording")
        return FoundLaw(verdict, would_tell(verdict, *spring.basis.ends), spring=spring)
    return _judged(found, spring, variable)


def _rolled(sums: Sequence[Sum], spring: Spring, until: float) -> list[Rolled]:
    """Sums that roll along the recording, the best first, with the smooth law's friction."""
    drags = spring.fit.numbers[spring.basis.count :]
    found = []
    for one in sums:
        if time.thread_time() > until:
            break
        rolled = rolled_along(one, spring.speeds, drags, spring)
        found += [] if rolled is None else [rolled]
    return sorted(found, key=lambda each: each.score)


def _shortened(found: Sequence[Rolled], until: float) -> list[Rolled]:
    """The best whose words do not all count without each of them, where that was not rolled."""
    kinds, out = {each.sum.kind for each in found}, []
    for each in found[:SHORTENED]:
        told, formula = each.formula("x")
        for less in [] if clear(formula) else told.shorter:
            if less.kind in kinds or time.thread_time() > until:
                continue
            kinds.add(less.kind)
            rolled = rolled_along(less, each.speeds, each.drags, each.spring)
            out += [] if rolled is None else [rolled]
    return out


def _braked(found: Sequence[Rolled], until: float) -> list[Rolled]:
    """The same sums with every other friction."""
    out: list[Rolled] = []
    for each in found:
        out += braked(each) if time.thread_time() < until else []
    return out


def samples_of(spring: Spring) -> Samples:
    """The smooth force at places that were visited, with its correlated errors.

    What no spline can follow, such as the cusp of a root at zero, is no misfit of a formula: it is
    looked at as the splines see it.
    """
    x, splines, force, covariance = _force(spring)
    floor = (COARSE * np.std(force)) ** 2 * np.eye(len(x))
    values, vectors = np.linalg.eigh(covariance + floor)
    seen = splines @ np.linalg.pinv(splines)
    return Samples(x, force, (vectors / np.sqrt(values)).T @ seen, spring.count)


def _force(spring: Spring) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Places, the splines there, the smooth force and its covariance."""
    basis = spring.basis
    x = np.linspace(basis.low, basis.high, PLACES)
    splines, k = basis.matrix(x), basis.count
    covariance = splines @ spring.covariance[:k, :k] @ splines.T
    return x, splines, splines @ spring.fit.numbers[:k], covariance


def _judged(found: list[Rolled], spring: Spring, variable: str) -> FoundLaw:
    """What the rolls say of each sum, and which stands out."""
    found = sorted(found, key=lambda each: each.score)
    best: dict[tuple[str, ...], Rolled] = {}
    for each in found:
        best.setdefault(each.sum.kind, each)
    told = []
    for each in best.values():
        worse = (each.fit.squares - spring.fit.squares) / spring.sigma**2
        free = max(spring.basis.count - each.sum.numbers, 1)
        if each.believed:
            told.append((*each.formula(variable), bool(worse < chdtri(free, STRANGE))))
    verdict = borne_out(chosen(told), spring)
    if verdict.formula is None:
        return FoundLaw(verdict, would_tell(verdict, *spring.basis.ends), found[0], (), spring)
    law = best[verdict.formula.kind]
    near = [x for x in found if x.sum.kind == law.sum.kind and x.score < law.score + SLIGHT]
    text = f"{variable}'' = {verdict.formula.text}"
    for word, value, _ in law.friction:
        text += f" {'-' if value < 0 else '+'} {abs(value):.3g} {spoken(word, variable)}"
    return FoundLaw(verdict, text, law, tuple(x.speeds for x in near), spring)


def borne_out(verdict: Verdict, spring: Spring) -> Verdict:
    """A formula, unless it could as well stand for a law that it is not."""
    if verdict.formula is None:
        return verdict
    count = len(verdict.formula.numbers)
    if count > MOST:
        return Verdict(None, f"no formula: sums of more than {MOST} numbers fit almost any force")
    if _known(spring) < AMPLE * count:
        return Verdict(None, FEW)
    return verdict


def _known(spring: Spring) -> int:
    """How many numbers the recording tells of a smooth force, each to within ``SURE``."""
    _, _, force, covariance = _force(spring)
    variances = np.linalg.eigvalsh(covariance / PLACES)[-spring.basis.count :]
    return int((variances < (SURE * np.std(force)) ** 2).sum())


def spoken(word: str, variable: str) -> str:
    """A word of the speed, as the rate of a variable."""
    return word.replace("x", variable).replace("v", f"{variable}'")
