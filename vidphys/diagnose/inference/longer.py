"""A last look at long recordings: what is too slow to show in one window, above all friction.

The winner's numbers are fitted again in windows that double until they span the recording or the
model no longer follows it, with every friction of the menu in turn; weak damping changes nothing
within a period and everything over twenty.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import FRICTION, FRICTIONS, Term, external_terms, of_each_body
from vidphys.diagnose.inference.refine import Fitted, refine
from vidphys.diagnose.inference.structures import Structure, price
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.weak.paths import splined
from vidphys.diagnose.weak.windows import FEW, FINEST, UNSEEN_BY, Windows, cut_windows

SMALL = 6  # coordinates of a scene that is fitted in long windows
FOLLOWS = 9.0  # times the noise's variance up to which a model follows a recording
TRAP_1D = external_terms(1, angles=False)[1]
START = 0.02  # per second, of a friction before it is fitted
SPARE = 1.5  # times the nodes that a window's path needs, which a window twice as long is given


@dataclass(frozen=True)
class LongFit:
    """A structure fitted in the longest windows in which it follows the recording.

    Args:
        fitted: numbers and errors.
        windows: those.
        probability: of each friction, by its kind, beside the terms that all have.
    """

    fitted: Fitted
    windows: Windows
    probability: dict[frozenset[str], float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Length of a window."""
        return float(self.windows.length.mean())

    def needed(self, sigma: float) -> int:
        """Nodes of a window that its paths need; see :meth:`Windows.nodes_needed`."""
        return self.windows.nodes_needed(self.fitted.paths.a, UNSEEN_BY * sigma)

    def follows(self, sigma: float) -> bool:
        """Whether it leaves about the noise, and its numbers mean what they say."""
        structure = self.fitted.structure
        means = all(
            not t.positive or (structure.of(t)[: max(1, len(t.parts))] > 0).all()
            for t in structure.terms
        )
        return means and self.fitted.variance <= FOLLOWS * sigma**2

    def score(self) -> float:
        """Log likelihood less the price of the numbers, comparable in equal windows."""
        rows = self.windows.seen.sum() * self.windows.frames.shape[-1]
        return float(-0.5 * self.fitted.freedom * np.log(self.fitted.variance)) - price(
            rows, len(self.fitted.values)
        )


def last_look(motion: Motion, inference: Inference) -> LongFit | None:
    """The structure and its numbers by the longest windows that it follows.

    Returns:
        ``None`` for short recordings, many bodies, random kicks, or a motion that the menu does
        not explain.
    """
    short = motion.positions.shape[1] <= FEW or motion.bodies * motion.space > SMALL
    if short or inference.kicks > 0 or not inference.leftover.explained:
        return None
    speed = float(np.sqrt(np.mean(inference.fitted.paths.v**2)))
    variants = _variants(inference.structure, speed)
    fits = [_longest(motion, inference, structure) for structure in variants]
    found = [fit for fit in fits if fit is not None]
    if not found:
        return None
    size = max(fit.windows.frames.shape[1] for fit in found)
    longest = [fit for fit in found if fit.windows.frames.shape[1] == size]
    free = next((fit for fit in found if fit.fitted.structure.term(FRICTION) is None), None)
    if free is not None and free.windows.frames.shape[1] < size:
        # What diverges from splines may not do so from paths that are nearly right.
        again = _along(longest[0], free.fitted.structure)
        longest += [again] if again is not None and again.follows(inference.noise.sigma) else []
    if motion.bodies > 1:
        apart = [_each_body(fit, motion.bodies) for fit in longest]
        longest += [fit for fit in apart if fit is not None]
    longest.sort(key=lambda fit: -fit.score())
    return replace(longest[0], probability=_probability(longest, inference.noise.sigma))


def _each_body(fit: LongFit, bodies: int) -> LongFit | None:
    """The same with a rate of friction for each body; none without friction."""
    structure, shared = fit.fitted.structure, fit.fitted.structure.term(FRICTION)
    if shared is None or shared.parts:
        return None
    terms = tuple(of_each_body(t, bodies) if t is shared else t for t in structure.terms)
    known = [np.repeat(structure.of(t), bodies if t is shared else 1) for t in structure.terms]
    apart = replace(structure, terms=terms, coefficients=np.concatenate(known))
    found = _along(fit, apart)
    if found is None:
        return None
    friction = found.fitted.structure.term(FRICTION)
    assert friction is not None
    return found if (found.fitted.structure.of(friction) > 0).all() else None


def _along(fit: LongFit, structure: Structure) -> LongFit | None:
    """Another structure in the windows of a fit, from its paths on; ``None`` where it diverges."""
    try:
        return LongFit(refine(fit.windows, fit.fitted.paths, structure), fit.windows)
    except (FloatingPointError, np.linalg.LinAlgError):
        return None


def _probability(fits: Sequence[LongFit], sigma: float) -> dict[frozenset[str], float]:
    """Of each friction; a residual above the noise is no independent evidence, and counts less."""
    best = fits[0]
    tempered = max(best.fitted.variance / max(sigma, np.finfo(float).tiny) ** 2, 1.0)
    weight: dict[frozenset[str], float] = {}
    for fit in fits:
        kinds = fit.fitted.structure.kinds
        likely = float(np.exp((fit.score() - best.score()) / tempered))
        weight[kinds] = max(likely, weight.get(kinds, 0.0))
    total = sum(weight.values())
    return {kinds: value / total for kinds, value in weight.items()}


def _variants(structure: Structure, speed: float) -> Iterator[Structure]:
    """The structure with each friction in place of its own, and with none.

    Args:
        structure: what was found in short windows.
        speed: a usual one, at which frictions that are not there yet begin at one rate.
    """
    own = structure.term(FRICTION)
    for kept in _externals(structure):
        values = [law for _, law in kept]
        terms = tuple(term for term, _ in kept)
        if own is not None and own.parts:
            both = np.concatenate([*values, structure.of(own)])
            yield replace(structure, terms=(*terms, own), coefficients=both)
        yield replace(structure, terms=terms, coefficients=np.concatenate([*values, []]))
        for power, friction in zip((1, 2, 0), FRICTIONS.values(), strict=True):
            same = own is not None and own.kind == friction.kind
            start = structure.of(own) if own and same else np.array([START * speed ** (1 - power)])
            coefficients = np.concatenate([*values, start])
            yield replace(structure, terms=(*terms, friction), coefficients=coefficients)


def _externals(structure: Structure) -> list[list[tuple[Term, np.ndarray]]]:
    """The terms but friction, with their numbers; and again with a plain trap for a bent one."""
    kept = [(term, structure.of(term)) for term in structure.terms if term.family != FRICTION]
    plain = [
        (TRAP_1D, values[:2]) if term.kind == "well" else (term, values) for term, values in kept
    ]
    return [kept] if all(term.kind != "well" for term, _ in kept) else [kept, plain]


def _longest(motion: Motion, inference: Inference, structure: Structure) -> LongFit | None:
    """Fits in windows that double, as long as the residual does not grow."""
    size, sigma = inference.windows.frames.shape[1], inference.noise.sigma
    total = motion.positions.shape[1]
    found, fine = None, 1.0
    while True:
        longer = _in_windows(motion, size, fine, structure, sigma)
        if longer is None or not longer.follows(sigma):
            return found
        found, structure = longer, longer.fitted.structure
        size, fine = found.windows.frames.shape[1], found.needed(sigma) / found.windows.usual
        if size >= total:
            return found
        size, fine = min(total, 2 * size), min(FINEST, SPARE * fine)


def _in_windows(
    motion: Motion, size: int, fine: float, structure: Structure, sigma: float
) -> LongFit | None:
    """A fit in windows of so many frames, with as many nodes as its paths need.

    Args:
        fine: of the windows that are tried first.
    """
    found: LongFit | None = None
    while True:
        windows = cut_windows(motion, size, fine)
        try:
            fitted = refine(windows, splined(windows, sigma), structure)
        except (FloatingPointError, np.linalg.LinAlgError):
            return None
        coarser, found = found, LongFit(fitted, windows)
        same = coarser is not None and fitted.as_told_by(coarser.fitted)
        if same or fine >= FINEST or found.needed(sigma) < len(windows.nodes):
            return found
        fine = min(FINEST, max(1.0, 2 * fine))


def looked_again(inference: Inference, look: LongFit) -> Inference:
    """The inference with the numbers of the last look, and its friction."""
    return replace(
        inference, fitted=look.fitted, windows=look.windows, probability=look.probability
    )
