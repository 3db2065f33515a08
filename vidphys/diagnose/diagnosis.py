"""The whole diagnosis: is there anything to see, which terms, did they change, and what is open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import special

from vidphys.coupling_verdict import PowerVerdict
from vidphys.diagnose.inference.changes import AROUND, Switch, find_switch
from vidphys.diagnose.inference.doubts import mistaken
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.linearised import resolved
from vidphys.diagnose.inference.longer import LongFit, last_look, looked_again
from vidphys.diagnose.inference.measured import settled
from vidphys.diagnose.inference.power import infer_with_power
from vidphys.diagnose.inference.search import infer, ranked
from vidphys.diagnose.inference.weigh import BELIEVED, in_balance, weigh
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion, Unseen
from vidphys.diagnose.recordings.noise import Noise, measure_noise
from vidphys.diagnose.weak.mending import Mended, mend

# Frames and degree of the polynomials by which motion is told from noise: slow motion that noise
# nearly hides, and fast swings, of six frames and more.
SMOOTH = ((2 * LEAST_FRAMES, 2), (LEAST_FRAMES, 3))
STILL = 1e-12  # of the size of the positions, below which a change is rounding
SHUFFLES = 100  # orders of the frames that motion is compared with
SURE = 1e-6  # chance that frames in any order look as smooth as this


@dataclass(frozen=True)
class Diagnosis:
    """What a recording says about its scene.

    Args:
        motion: what was looked at; with the masses that were found, where they were not given.
        noise: of the positions.
        refused: why no answer is given at all, or empty.
        inference: which terms, of the whole recording.
        switch: where the strengths change in mid-clip.
        parts: the terms before and after the switch.
        power: which powers of the coupling are possible, where couplings are known.
        look: the fit to the longest windows, of long recordings.
        mended: what was done to the tracks before anything was fitted.
        weighed: whether the masses were found, not given.
    """

    motion: Motion
    noise: Noise
    refused: str
    inference: Inference | None = None
    switch: Switch | None = None
    parts: tuple[Inference, ...] = ()
    power: PowerVerdict | None = None
    look: LongFit | None = None
    mended: Mended | None = None
    weighed: bool = False

    @property
    def told(self) -> bool:
        """Whether the answer is told without a doubt: these terms, or none of the menu's."""
        if self.explained or not self.inferences:
            return self.sure
        one = self.motion.bodies == 1 or not np.allclose(self.motion.mass, 1.0)
        return one and any(
            x.leftover.certain and resolved(x) and not mistaken(x, self.swaps)
            for x in self.inferences
        )

    @property
    def swaps(self) -> int:
        """How often names were swapped, before that was mended."""
        return 0 if self.mended is None else self.mended.swaps

    @property
    def inferences(self) -> tuple[Inference, ...]:
        """Of the parts before and after a switch; without one, of the whole; none if refused."""
        return self.parts or ((self.inference,) if self.inference else ())

    @property
    def explained(self) -> bool:
        """Whether the menu explains the motion, with a switch if there is one."""
        return bool(self.inferences) and all(x.leftover.explained for x in self.inferences)

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of all terms that were found."""
        return frozenset().union(*(x.kinds for x in self.inferences))

    @property
    def sure(self) -> bool:
        """Whether the answer stands alone."""
        return (
            not self.outweighed and bool(self.inferences) and all(x.sure for x in self.inferences)
        )

    @property
    def outweighed(self) -> bool:
        """Whether masses were found of which the largest hardly shows beside the smallest."""
        return self.weighed and float(self.motion.mass.max() / self.motion.mass.min()) > BELIEVED


def diagnose_motion(motion: Motion, angles: bool = False) -> Diagnosis:
    """Find what a scene requires.

    Args:
        motion: tracks of its bodies.
        angles: whether the coordinates are joint angles in radians.

    Example:
        >>> from vidphys.diagnose.recordings.motion import motion_of
        >>> t = np.arange(60) * 0.05
        >>> fall = np.stack([t, 2 * t - 0.5 * 9.81 * t**2], -1)[None, :, None]
        >>> noise = 1e-3 * np.random.default_rng(0).standard_normal(fall.shape)
        >>> found = diagnose_motion(motion_of(fall + noise, 0.05))
        >>> sorted(found.kinds), found.explained
        (['uniform'], True)
    """
    noise = measure_noise(motion)
    refused = nothing_to_see(motion)
    mended = mend(motion)
    motion = mended.motion
    if refused and (mended.false_finds or mended.swaps):
        refused = nothing_to_see(motion)
    if refused:
        return Diagnosis(motion, noise, refused)
    settle = partial(settled, infer=partial(infer_with_power, angles=angles))
    best = weighed = in_balance(motion, settle)
    if best is None:
        alike = settle(motion)
        weighed = weigh(motion, alike.inference, settle, partial(ranked, angles=angles))
        best = weighed or alike
    motion, inference = best.motion, best.inference
    found = Diagnosis(
        motion,
        measure_noise(motion),
        "",
        inference,
        power=best.power,
        mended=mended,
        weighed=weighed is not None,
    )
    switch = None if inference.stands else find_switch(motion, inference)
    if switch is not None:
        parts = _parts(motion, switch, angles)
        if parts:
            return replace(found, switch=switch, parts=parts)
    look = last_look(motion, inference)
    again = inference if look is None else looked_again(inference, look)
    if look is None or (found.outweighed and again.kinds != inference.kinds):
        return found  # what masses that hardly show leave over long is no other term
    return replace(found, inference=again, look=look)


def _parts(motion: Motion, switch: Switch, angles: bool) -> tuple[Inference, ...]:
    """What explains the motion before a switch and after it; nothing where either is left open."""
    parts: list[Inference] = []
    # The moment is known to a few frames only; the parts need some.
    before = max(switch.frame - AROUND, LEAST_FRAMES)
    after = min(switch.frame + AROUND, motion.positions.shape[1] - LEAST_FRAMES)
    for half in (motion.cut(0, before), motion.cut(after)):
        try:
            parts.append(infer(half, angles))
        except Unseen:
            return ()
        if not parts[-1].leftover.explained:
            return ()
    return tuple(parts)


def nothing_to_see(motion: Motion) -> str:
    """Why there is no motion to diagnose, or an empty string.

    Motion is smooth, and no other order of its frames is as smooth: where polynomials explain no
    more of the positions in stretches of the clips than they would of the same frames mixed up,
    nothing moves, or the frames are out of order already.
    """
    spread = np.nanmax(np.nanstd(motion.positions, axis=1))
    if not spread > STILL * np.nanmax(np.abs(motion.positions)):
        return "nothing moves"
    for frames, degree in SMOOTH:
        size = min(motion.positions.shape[1], frames)
        stretches = _stretches(motion, size)
        if not stretches:
            return f"no body is seen in {size} frames in a row; a force cannot show"
        if _by_chance(stretches, degree) < SURE:
            return ""
    return (
        "nothing above the noise moves smoothly: the bodies are at rest, the noise hides them, the "
        "frames are out of order, or a swing lasts less than six of them"
    )


def _by_chance(stretches: list[np.ndarray], degree: int) -> float:
    """Chance that stretches ``(rows, frames)`` look as smooth as they do with frames in any order.

    All are mixed up alike, because clips that were put out of order together are one accident, not
    many.
    """
    rng = np.random.default_rng(0)
    size = stretches[0].shape[1]
    slow = np.linalg.qr(np.vander(np.linspace(-1, 1, size), degree + 1, increasing=True))[0]
    mixed = [
        _smoothness([x[:, rng.permutation(size)] for x in stretches], slow) for _ in range(SHUFFLES)
    ]
    beyond = (_smoothness(stretches, slow) - np.mean(mixed)) / max(float(np.std(mixed)), STILL)
    return float(special.ndtr(-beyond))


def _stretches(motion: Motion, size: int) -> list[np.ndarray]:
    """Coordinates ``(k, size)`` of so many frames in a row that show a body: first, next, ..."""
    pieces: dict[int, list[np.ndarray]] = {}
    for path, seen in zip(motion.positions, motion.seen, strict=True):
        for body in range(motion.bodies):
            ends = np.flatnonzero(np.diff(seen[:, body], prepend=False, append=False))
            starts = [
                first
                for begin, end in ends.reshape(-1, 2)
                for first in range(begin, end - size + 1, size)
            ]
            for number, first in enumerate(starts):
                pieces.setdefault(number, []).append(path[first : first + size, body].T)
    return [np.concatenate(pieces[number]) for number in sorted(pieces)]


def _smoothness(stretches: list[np.ndarray], slow: np.ndarray) -> float:
    """Logarithm of what slow polynomials explain of ``(rows, frames)``, over what they leave.

    Args:
        stretches: positions of each body and axis in a row.
        slow: the polynomials, orthonormal, the constant one first, ``(frames, polynomials)``.
    """
    told = left = 0.0
    for x in stretches:
        part = x @ slow
        told += float((part[:, 1:] ** 2).sum())
        left += float((x**2).sum() - (part**2).sum())
    least = np.finfo(float).tiny
    return float(np.log(max(told, least)) - np.log(max(left, least)))
