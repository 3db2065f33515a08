"""A switch in mid-clip: did the strengths of the terms change at some moment, and when?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import FRICTION, FRICTIONS, Term, field_of
from vidphys.diagnose.inference.refine import refine
from vidphys.diagnose.inference.search import NUMERICAL
from vidphys.diagnose.inference.structures import Structure, price
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion, Unseen
from vidphys.diagnose.weak.paths import Paths, integrated, smooth
from vidphys.diagnose.weak.regression import Normal, Rows, normal_equations, rows_of
from vidphys.diagnose.weak.windows import Windows, cut_windows, windows_at

PIECES = (8, 16)  # frames of the windows, at least and at most
AT_FIRST, AROUND = 48, 2  # splits that are tried over the clip; on each side of the best, after it
PICARD = 3
APART = 4.0  # standard errors between the numbers of the two parts
MATERIAL = 0.05  # share of the usual acceleration that a change of a number must make


@dataclass(frozen=True)
class Switch:
    """The moment at which strengths changed.

    Args:
        frame: the first of the second part.
        time: seconds, of that frame in the first clip.
        gain: of log likelihood by the switch, less its price.
        before, after: coefficients by name, of the two parts.
    """

    frame: int
    time: float
    gain: float
    before: dict[str, float]
    after: dict[str, float]


def find_switch(motion: Motion, inference: Inference) -> Switch | None:
    """The likeliest moment of a switch, if one is likely at all.

    Args:
        motion: the clips; a switch happens at one frame of all.
        inference: of the whole; gives the terms, to which a linear friction is added where there
            is none.
    """
    frames = motion.positions.shape[1]
    inference = _parted(inference)
    splits = np.arange(LEAST_FRAMES, frames - LEAST_FRAMES + 1)
    terms = _terms(inference.structure)
    size = int(np.clip(inference.windows.frames.shape[1], *PIECES))
    splits = splits[(splits >= size) & (splits <= frames - size)]
    if len(splits) < 2:
        return None
    try:
        best, (gain, before, after) = _likeliest(
            splits, lambda split: _exact_gain(motion, inference, terms, split, size)
        )
        # One of many moments was picked: that choice has its price too.
        gain -= float(np.log(len(splits)))
        if gain <= 0 or not _confirmed(motion, inference, terms, best, size):
            return None
    except Unseen:  # on one side of a moment
        return None
    names = [f"{term.name}: {part}" for term in terms for part in term.coefficients]
    return Switch(
        best,
        float(motion.times[0, best]),
        gain,
        dict(zip(names, before.tolist(), strict=True)),
        dict(zip(names, after.tolist(), strict=True)),
    )


Gain = tuple[float, np.ndarray, np.ndarray]


def _likeliest(splits: np.ndarray, gain_of: Callable[[int], Gain]) -> tuple[int, Gain]:
    """The split of the largest gain: of some over the clip, then of nearer and nearer ones."""
    step = max(1, len(splits) // AT_FIRST)
    tried = {int(s): gain_of(int(s)) for s in splits[::step]}
    while True:
        best = max(tried, key=lambda s: tried[s][0])
        if step == 1:
            return best, tried[best]
        step = (step + 1) // 2
        near = range(best - AROUND * step, best + AROUND * step + 1, step)
        within = (s for s in near if splits[0] <= s <= splits[-1] and s not in tried)
        tried |= {s: gain_of(s) for s in within}


def _confirmed(
    motion: Motion, inference: Inference, terms: tuple[Term, ...], frame: int, size: int
) -> bool:
    """Whether the exact fits of the two parts differ by more than their errors, and visibly.

    The search runs along paths of the whole clip's model, whose error (an under-resolved contact,
    say) may favour one part by chance; the parts' own fits have none of it.
    """
    known = [inference.structure.of(t) if t in inference.structure.terms else [0.0] for t in terms]
    structure = replace(inference.structure, terms=terms, coefficients=np.concatenate(known))
    fits = []
    for half in (motion.cut(0, frame), motion.cut(frame)):
        windows = cut_windows(half, size)
        try:
            fitted = refine(windows, smooth(windows, inference.noise.sigma), structure)
        except (FloatingPointError, np.linalg.LinAlgError):
            return True
        field = field_of(windows, fitted.paths)
        columns = np.concatenate([term.columns(field) for term in terms], -1)
        usual = np.sqrt(np.mean(fitted.structure.accelerations(field) ** 2)) + np.finfo(float).tiny
        fits.append((fitted, np.sqrt((columns**2).mean((0, 1, 2, 3))) / usual))
    (before, share), (after, other) = fits
    count = len(share)
    gap = np.abs(after.values - before.values)[:count]
    error = np.hypot(after.errors, before.errors)[:count]
    return bool(((gap > APART * error) & (gap * np.maximum(share, other) > MATERIAL)).any())


def _terms(structure: Structure) -> tuple[Term, ...]:
    linear = FRICTIONS["linear"]
    return structure.terms if linear in structure.terms else (*structure.terms, linear)


def _parted(inference: Inference) -> Inference:
    """The same with two frictions as terms of their own, each of which may change alone."""
    structure = inference.structure
    parts = [t.parts if t.family == FRICTION and t.parts else (t,) for t in structure.terms]
    parted = replace(structure, terms=tuple(term for some in parts for term in some))
    return replace(inference, fitted=replace(inference.fitted, structure=parted))


def _path(windows: Windows, inference: Inference) -> Paths:
    """Paths by the whole clip's model, corrected in each window by its own fit to the frames."""
    paths = smooth(windows, inference.noise.sigma)
    for _ in range(PICARD):
        a = inference.structure.accelerations(field_of(windows, paths))
        paths = integrated(windows, a)
    return paths


def _rows(windows: Windows, inference: Inference, terms: tuple[Term, ...]) -> Rows:
    field = field_of(windows, _path(windows, inference))
    return rows_of(windows, np.concatenate([term.columns(field) for term in terms], -1))


def _exact_gain(
    motion: Motion, inference: Inference, terms: tuple[Term, ...], split: int, size: int
) -> Gain:
    """Gain of log likelihood less the price, in windows none of which holds the split."""
    frames = motion.positions.shape[1]
    firsts = [*range(split % size, split, size), *range(split, frames - size + 1, size)]
    starts = np.array(firsts)
    clip, first = np.meshgrid(np.arange(motion.clips), starts, indexing="ij")
    windows = windows_at(motion, clip.ravel(), first.ravel(), size)
    rows = _rows(windows, inference, terms)
    ratio = inference.kicks / inference.fitted.variance
    late = windows.first[rows.window] >= split
    whole, after = normal_equations(rows, ratio), normal_equations(rows, ratio, late)
    count = len(whole.moment)
    unchanged = whole.solve(range(count))
    floor = NUMERICAL * motion.spread
    start = whole.log_likelihood(whole.misfit(range(count), unchanged), floor)
    found = []
    for columns in _may_change(terms):
        both = _with_change(whole, after, columns)
        everything = range(len(both.moment))
        values = both.solve(everything)
        apart = both.log_likelihood(both.misfit(everything, values), floor) - start
        later = values[:count].copy()
        later[columns] += values[count:]
        gain = apart - price(whole.count, len(columns) + 1)
        found.append((float(gain), values[:count], later))
    return max(found, key=lambda f: f[0])


def _may_change(terms: tuple[Term, ...]) -> list[list[int]]:
    """Columns that change together: those of one term, or all."""
    ends = np.cumsum([len(term.coefficients) for term in terms])
    each = [
        list(range(end - len(term.coefficients), end))
        for term, end in zip(terms, ends, strict=True)
    ]
    return [*each, list(range(int(ends[-1])))] if len(each) > 1 else each


def _with_change(whole: Normal, after: Normal, columns: list[int]) -> Normal:
    """Normal equations of all numbers, and of what is added to some after the switch."""
    across = after.gram[:, columns]
    gram = np.block([[whole.gram, across], [across.T, after.gram[np.ix_(columns, columns)]]])
    moment = np.concatenate([whole.moment, after.moment[columns]])
    return Normal(gram, moment, whole.power, whole.count, whole.log_weight)
