"""From motion to terms: windows that grow as far as the model reaches, and what is left over.

1. Smooth paths by polynomials in short windows; try every combination of the menu.
2. Replace the paths by the best model's own, and try again; so noise leaves the columns.
3. Look for random kicks; where there are any, weigh the rows by them.
4. Lengthen the windows while the model explains them as well as the short ones.
5. Fit the numbers of the winner without approximation, and try every combination once more.
6. Fit its rivals too, each along its own paths; where one is likelier, go on from there once.
7. Ask whether anything is left that noise and kicks do not explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynamics.powers import COUPLINGS
from vidphys.diagnose.inference.hearing import Heard, between_powers, heard, key_of, reweighed
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import (
    FRICTIONS,
    PAIR,
    TWO_FRICTIONS,
    Field,
    Term,
    external_terms,
    field_of,
    pair_terms,
)
from vidphys.diagnose.inference.refine import Fitted, refine, unrefined
from vidphys.diagnose.inference.residual import leftover, random_kicks
from vidphys.diagnose.inference.stretches import of_one_stretch
from vidphys.diagnose.inference.structures import Menu, Structure, all_structures, posterior
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import Noise, measure_noise
from vidphys.diagnose.weak.paths import Paths, integrated, smooth, with_kicks
from vidphys.diagnose.weak.regression import Rows, normal_equations, rows_of
from vidphys.diagnose.weak.windows import UNSEEN_BY, Windows, cut_windows

FIRST = 16  # frames of the windows from which the time scale is read
SHORTEST, LONGEST = 8, 64  # frames
REACH = 1.2  # of the first windows, over the time scale of the motion
GROWTH = 1.6
FARTHEST = 2.5  # of the last windows, over the time scale of the model's motion
NO_WORSE = 0.03  # share by which the mean square residual may grow in longer windows
CHANCE = 2.0  # or so many standard deviations of a mean square
PICARD = 4
CLOSELY = 3  # shapes of pair forces whose lengths are looked for closely
KICKED = 8.0  # gain of log likelihood from which random kicks are believed
SHOVED = 3.0  # times the numerical error that kicks must move a row to be no such error
FINER = 4.0  # times the usual nodes, which tell a close encounter from a kick
NUMERICAL = 3e-4  # of the spread of the positions: what the integrals themselves may be wrong by


@dataclass(frozen=True)
class _Round:
    """One pass over all combinations."""

    windows: Windows
    paths: Paths
    menu: Menu
    rows: Rows
    structures: list[Structure]
    ratio: float

    @property
    def best(self) -> Structure:
        return self.structures[0]


def infer(motion: Motion, angles: bool = False, power: str = "linear") -> Inference:
    """Find the terms of a scene from its motion.

    Args:
        motion: tracks.
        angles: whether positions are joint angles (a pendulum is then on the menu).
        power: how forces of pairs go with the coupling, where it is known; of
            :data:`dynamics.powers.COUPLINGS`.
    """
    if motion.coupling is not None:
        motion = replace(motion, coupling=COUPLINGS[power](motion.coupling))
    noise = measure_noise(motion)
    floor = NUMERICAL * motion.spread
    search = _Search(motion, angles, max(noise.sigma, floor), floor)
    size = search.first_size()
    result = search.from_windows(size, noise)
    # A close encounter that is over before a window's nodes can follow it looks like a kick too.
    if result.kicks and result.leftover.explained and search.is_too_coarse_for(result):
        finer = replace(search, fine=FINER).from_windows(size, noise)
        result = finer if finer.without_kicks else result
    # A rare encounter that a long first window smooths over looks like a kick; in shorter ones it
    # does not.
    while result.kicks > 0 and not result.leftover.explained and size >= 2 * SHORTEST:
        size //= 2
        shorter = search.from_windows(size, noise)
        if shorter.without_kicks:
            return shorter
    return result


def ranked(motion: Motion, frames: int, angles: bool = False) -> list[Structure]:
    """Every combination of terms along smooth paths in windows of so many frames, best first."""
    floor = NUMERICAL * motion.spread
    search = _Search(motion, angles, max(measure_noise(motion).sigma, floor), floor)
    return search.round(frames, None).structures


def _likely_pairs(structures: Sequence[Structure]) -> list[Term]:
    """The best pair force of each of the likeliest shapes.

    Of each its length is looked for more closely: a shape must not win by a happier grid.
    """
    found: dict[str, Term] = {}
    for structure in structures:
        pair = structure.term(PAIR)
        if pair is not None and pair.shape not in found:
            found[pair.shape] = pair
        if len(found) == CLOSELY:
            break
    return list(found.values())


@dataclass(frozen=True)
class _Search:
    motion: Motion
    angles: bool
    sigma: float
    floor: float
    fine: float = 1.0  # see Windows

    def is_too_coarse_for(self, found: Inference) -> bool:
        """Whether bodies may pass each other by faster than the nodes of a window can follow."""
        needed = found.windows.nodes_needed(found.fitted.paths.a, UNSEEN_BY * self.sigma)
        return found.structure.term(PAIR) is not None and needed == len(found.windows.nodes)

    def from_windows(self, size: int, noise: Noise) -> Inference:
        """The whole search from first windows of this many frames."""
        found = self.round(size, None)
        found = self.round(found.windows.frames.shape[1], found)
        fitted, found = self.settled(self.grown(self.kicked(self.refined(found)[1])))
        fits = self.heard(found)
        if fits and fits[0].key != key_of(found.best):
            # Windows may be longer, and kicks none, with terms that fit better.
            other = self.along(found, self.pushed(found, fits[0].fitted))
            fitted, found = self.settled(self.grown(self.kicked(replace(other, ratio=0.0))))
            fits = self.heard(found)
        if fits and fits[0].key != key_of(fitted.structure):
            fitted = self.pushed(found, fits[0].fitted)
        structures = reweighed(found.structures, fits) if fits else found.structures
        return self.conclude(fitted, replace(found, structures=structures), noise)

    def first_size(self) -> int:
        """Frames of the first windows: about the time in which velocities change."""
        paths = smooth(cut_windows(self.motion, FIRST), self.sigma)
        return max(int(self.frames_of(paths.v, paths.a, REACH)), SHORTEST)

    def frames_of(self, v: np.ndarray, a: np.ndarray, reach: float) -> float:
        """Frames in which velocities change by their spread, times ``reach``; ``LONGEST`` at most.

        Args:
            v, a: along paths, ``(w, m, n, d)``.
            reach: see there.
        """
        spread = np.sqrt(np.mean((v - v.mean((0, 1, 2))) ** 2))
        in_a_frame = np.sqrt(np.mean(a**2)) * self.motion.interval
        if reach * spread >= LONGEST * in_a_frame:
            return LONGEST
        return float(reach * spread / in_a_frame)

    def terms(self, field: Field, near: Sequence[Term]) -> list[Term]:
        terms = external_terms(self.motion.space, self.angles)
        terms += [*FRICTIONS.values(), *TWO_FRICTIONS]
        if self.motion.bodies > 1:
            alike = bool(np.allclose(self.motion.mass, 1.0))
            for source in ("alike",) if alike else ("mass", "alike"):
                close = [term for term in near if term.source == source]
                terms += pair_terms(field.distance, source, close)
        return terms

    def round(self, frames: int, before: _Round | None) -> _Round:
        """Try every combination in windows of this many frames, along the last best paths."""
        windows = cut_windows(self.motion, frames, self.fine)
        paths = smooth(windows, self.sigma)
        ratio = before.ratio if before else 0.0
        if before is not None:
            for _ in range(PICARD):
                paths = integrated(windows, before.best.accelerations(field_of(windows, paths)))
                if ratio:
                    paths = with_kicks(windows, paths, ratio)
        return self.tried(windows, paths, before.structures if before else (), ratio)

    def tried(
        self, windows: Windows, paths: Paths, last: Sequence[Structure], ratio: float
    ) -> _Round:
        """Every combination along given paths; ``last`` are those of the last ones, best first."""
        field = field_of(windows, paths)
        menu = Menu(tuple(self.terms(field, _likely_pairs(last))))
        rows = rows_of(windows, menu.columns(field))
        return _Round(windows, paths, menu, rows, self.ranked(menu, rows, ratio), ratio)

    def ranked(self, menu: Menu, rows: Rows, ratio: float) -> list[Structure]:
        """All combinations, best first; kicks come with the linear friction that balances them."""
        if not ratio:
            return all_structures(menu, normal_equations(rows), self.floor, self.floor)
        found = all_structures(menu, normal_equations(rows, ratio), self.least(rows, ratio))
        bath = [s for s in found if "linear" in s.kinds]
        return bath or found

    def least(self, rows: Rows, ratio: float) -> float:
        """What noise may be beside kicks: rows that these move are not numerical error."""
        return self.floor / float(np.sqrt(1 + ratio * rows.kicks.mean()))

    def refined(self, found: _Round) -> tuple[Fitted, _Round]:
        """The winner's numbers, and every combination once more along the paths that they give."""
        try:
            fitted = refine(found.windows, found.paths, found.best, found.ratio)
        except (FloatingPointError, np.linalg.LinAlgError):
            fitted = unrefined(found.windows, found.paths, found.best)
        fitted = self.pushed(found, fitted)
        return fitted, self.along(found, fitted)

    def pushed(self, found: _Round, fitted: Fitted) -> Fitted:
        """A fit whose paths follow the random kicks too, where there are any."""
        if not found.ratio:
            return fitted
        return replace(fitted, paths=with_kicks(found.windows, fitted.paths, found.ratio))

    def along(self, found: _Round, fitted: Fitted) -> _Round:
        """Every combination once more, along the paths of a fit."""
        last = [fitted.structure, *found.structures]
        return self.tried(found.windows, fitted.paths, last, found.ratio)

    def kicked(self, found: _Round) -> _Round:
        """With random kicks, if they are believed.

        Every friction and external force is left free: what a missing one leaves is no kick.
        """
        pair = found.best.term(PAIR)
        free = [
            place
            for term, places in zip(found.menu.terms, found.menu.places, strict=True)
            for place in places
            if term.family != PAIR or term is pair
        ]
        kicks = random_kicks(found.rows, free, self.floor)
        if kicks.gain <= KICKED or kicks.moved < SHOVED * self.floor:
            return found
        structures = self.ranked(found.menu, found.rows, kicks.ratio)
        return replace(found, structures=structures, ratio=kicks.ratio)

    def grown(self, found: _Round) -> _Round:
        """Longer windows, as long as the residual stays and the weak form is near its best."""
        while True:
            size = found.windows.frames.shape[1]
            longest = self.longest(found)
            longer = min(longest, int(GROWTH * size) + 1)
            if longer <= size:
                return found
            tried = self.round(longer, found)
            if found.ratio:
                tried = self.kicked(replace(tried, ratio=0.0))
            if tried.windows.frames.shape[1] <= size:
                return found
            chance = CHANCE * np.sqrt(2 / len(tried.rows.y))
            allowed = (1 + max(NO_WORSE, chance)) * found.best.misfit + self.floor**2
            if tried.best.misfit > allowed:
                return found
            found = tried

    def longest(self, found: _Round) -> int:
        """Frames in which the best model's velocities change as often as windows may hold."""
        field = field_of(found.windows, found.paths)
        frames = self.frames_of(field.v, found.best.accelerations(field), FARTHEST)
        return int(min(frames, self.motion.positions.shape[1]))

    def settled(self, found: _Round) -> tuple[Fitted, _Round]:
        """The winner's numbers; where the combinations then rank differently, once more."""
        fitted, again = self.refined(found)
        if again.best.kinds != fitted.structure.kinds:
            fitted, again = self.refined(again)
        return fitted, again

    def heard(self, found: _Round) -> list[Heard]:
        """The likeliest combinations along their own paths, best first."""
        least = self.least(found.rows, found.ratio)
        return heard(found.windows, found.paths, found.structures, found.ratio, least)

    def conclude(self, fitted: Fitted, found: _Round, noise: Noise) -> Inference:
        """What is told of the best fit, and of every combination beside it."""
        rest = leftover(found.windows, fitted, found.ratio, self.sigma, self.floor)
        kicks = found.ratio * fitted.variance
        return Inference(
            fitted,
            found.windows,
            noise,
            posterior(found.structures),
            kicks,
            rest.kicks_gain if kicks else 0.0,
            rest,
            tuple(found.structures),
            of_one_stretch(found.menu, found.rows, found.structures, found.ratio),
            between_powers(found.windows, fitted, found.ratio, self.least(found.rows, found.ratio)),
        )
