"""Recorded motion: where bodies were, and when; what every question of a diagnosis starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.recordings.colour import Colour
from vidphys.diagnose.recordings.inputs import Signal

LONGEST_GAP = 1e5  # usual intervals
LARGEST = 1e100  # positions; what is squared and summed must stay finite
APART = 4.0  # spreads of each, that those of all count for at most
LEAST_FRAMES = 8


class Unseen(ValueError):
    """No stretch of a recording shows all bodies."""


@dataclass(frozen=True)
class Motion:
    """Positions of bodies in one or several clips.

    Args:
        positions: ``(e, t, n, d)``, world units; NaN where a body was not seen.
        times: seconds of each frame, ``(e, t)``, increasing.
        mass: ``(e, n)``; ones where nothing is known.
        coupling: strength of the law in each clip, ``(e,)``, where it was set and is known.
        inputs: what drives the scene and was recorded, of each clip, over all of its time.
        colour: of the noise, where it is known to have a memory.
        spin_fades: share a second by which the spin of a body that is seen to spin fades.
        ahead: places in frames after these that are held out, ``(e, f, n, d)``: they may draw the
            curve that a body keeps to, not tell when it is where.

    Raises:
        ValueError: shapes that do not belong together, times that do not increase, or too few
            frames to show a force.
    """

    positions: np.ndarray
    times: np.ndarray
    mass: np.ndarray
    coupling: np.ndarray | None = None
    inputs: tuple[Signal, ...] = ()
    colour: Colour | None = None
    spin_fades: float | None = None
    ahead: np.ndarray | None = None

    def __post_init__(self) -> None:
        clips, frames, bodies, _ = self.positions.shape
        if self.times.shape != (clips, frames) or self.mass.shape != (clips, bodies):
            raise ValueError(
                f"Motion: positions {self.positions.shape} need times ({clips}, {frames}) and "
                f"mass ({clips}, {bodies}), got {self.times.shape} and {self.mass.shape}"
            )
        if frames < LEAST_FRAMES:
            raise ValueError(
                f"Motion: a force shows in {LEAST_FRAMES} frames or more, got {frames}; give a "
                "longer recording"
            )
        if not np.isfinite(self.times).all():
            raise ValueError("Motion: times must be finite numbers")
        steps = np.diff(self.times)
        if not (steps > 0).all():
            raise ValueError("Motion: times must increase within each clip")
        if steps.max() > LONGEST_GAP * np.median(steps):
            raise ValueError(
                f"Motion: between two frames lie {steps.max():.3g} s, usual are "
                f"{np.median(steps):.3g} s; cut the recording there, or mend its times"
            )
        if np.nanmax(np.abs(self.positions), initial=0.0) > LARGEST:
            raise ValueError(f"Motion: positions beyond {LARGEST:.0e}; count in another unit")

    @property
    def clips(self) -> int:
        """Number of clips."""
        return self.positions.shape[0]

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return self.positions.shape[2]

    @property
    def space(self) -> int:
        """Dimensions of space."""
        return self.positions.shape[3]

    @property
    def interval(self) -> float:
        """Median seconds between frames."""
        return float(np.median(np.diff(self.times)))

    @property
    def seen(self) -> np.ndarray:
        """Which bodies were seen in which frame, ``(e, t, n)``."""
        return np.isfinite(self.positions).all(-1)

    @property
    def spread(self) -> float:
        """Standard deviation of all coordinates, world units; of bodies that are far apart for how
        little they move, a few times that of each about its own mean.
        """
        own = np.sqrt(np.nanmean(np.nanvar(self.positions, axis=1)))
        return float(min(np.nanstd(self.positions), APART * own))

    @property
    def moves(self) -> bool:
        """Whether any body is ever at another place."""
        return bool(np.nanmax(np.nanstd(self.positions, axis=1)) > 0)

    def shown(self) -> tuple[int, int]:
        """First frame in which a body was seen, and the frame after the last; of any clip."""
        frames = np.flatnonzero(self.seen.any((0, 2)))
        return (int(frames[0]), int(frames[-1]) + 1) if len(frames) else (0, 0)

    def reversed(self) -> Motion:
        """The same clips run backwards."""
        inputs = tuple(Signal(x.names, -x.times[::-1], x.values[::-1]) for x in self.inputs)
        times = -self.times[:, ::-1].copy()
        return replace(self, positions=self.positions[:, ::-1], times=times, inputs=inputs)

    def cut(self, first: int, stop: int | None = None) -> Motion:
        """Frames ``first`` to ``stop`` of every clip."""
        return replace(
            self, positions=self.positions[:, first:stop], times=self.times[:, first:stop]
        )

    def of(self, bodies: Sequence[int]) -> Motion:
        """Some of the bodies."""
        some = list(bodies)
        ahead = None if self.ahead is None else self.ahead[:, :, some]
        return replace(
            self, positions=self.positions[:, :, some], mass=self.mass[:, some], ahead=ahead
        )

    def take(self, clips: np.ndarray) -> Motion:
        """Some of the clips."""
        coupling = None if self.coupling is None else self.coupling[clips]
        inputs = tuple(self.inputs[i] for i in np.arange(self.clips)[clips] if self.inputs)
        return replace(
            self,
            positions=self.positions[clips],
            times=self.times[clips],
            mass=self.mass[clips],
            coupling=coupling,
            inputs=inputs,
            ahead=None if self.ahead is None else self.ahead[clips],
        )


def motion_of(
    positions: np.ndarray,
    interval: float,
    mass: np.ndarray | None = None,
    coupling: np.ndarray | None = None,
) -> Motion:
    """Motion from evenly spaced frames.

    Args:
        positions: ``(e, t, n, d)``.
        interval: seconds between frames.
        mass: ``(e, n)``.
        coupling: ``(e,)``.

    Example:
        >>> seconds = np.arange(20) * 0.1
        >>> motion = motion_of(np.sin(seconds).reshape(1, 20, 1, 1), interval=0.1)
        >>> motion.clips, motion.bodies, motion.space, round(motion.interval, 3)
        (1, 1, 1, 0.1)
    """
    clips, frames, bodies, _ = positions.shape
    times = np.tile(np.arange(frames) * interval, (clips, 1))
    weight = np.ones((clips, bodies)) if mass is None else mass
    return Motion(np.asarray(positions, float), times, weight, coupling)
