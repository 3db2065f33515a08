"""The weak form: what accelerations along a path mean for the positions that were recorded.

A recording is cut into windows. Within one, position = x0 + v0 t + the acceleration integrated
twice; test functions that are orthogonal to 1 and t leave the last part alone, so that neither a
speed nor an acceleration is ever read from differences of noisy frames. Noise of the frames stays
white under orthonormal test functions, and noise with a memory becomes so under functions that are
whitened by its covariance; they are turned so that random kicks (a bath) come out independent too,
with the variance ``kicks`` per unit of their strength.

Paths are kept at Chebyshev nodes, where integrals are as exact as the path is smooth: of a long
window in panels that follow each other, so that a fit costs as much as the window is long.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from vidphys.diagnose.recordings.colour import Colour
from vidphys.diagnose.recordings.motion import Motion, Unseen

LEAST = 5  # frames of a body in a window, below which it tells nothing of its acceleration
NODES_PER_FRAME = 1.5
NODES = (16, 32)
FEW = 64  # frames of a window, above which it has a node a frame as a rule
FINEST = 8.0  # times the usual nodes, at most
UNSEEN_BY = 1e-4  # of the noise, by which nodes that are left out may move a body
PANEL = 32  # nodes of a panel, about; a window of fewer than twice as many is one panel
SAME = 1e-9  # share of a window by which times of frames may differ and count as equal
UNSEEN = 1e9  # variance of a frame in which a body was not seen, over that of the noise
STRETCH = 1.5  # by which windows may be longer than asked for, rather than leave frames out


def apart(x: np.ndarray) -> np.ndarray:
    """What is told of each body of each window, ``(w, k, n, ...) -> (w n, k, 1, ...)``."""
    return np.swapaxes(x, 1, 2).reshape(-1, x.shape[1], 1, *x.shape[3:])


def together(x: np.ndarray, bodies: int) -> np.ndarray:
    """The way back, ``(w n, k, 1, ...) -> (w, k, n, ...)``."""
    return np.swapaxes(x.reshape(-1, bodies, x.shape[1], *x.shape[3:]), 1, 2)


@dataclass(frozen=True)
class Windows:
    """Windows of a recording, all of one number of frames.

    Args:
        frames: positions ``(w, f, n, d)``, zero where not seen.
        seen: ``(w, f, n)``.
        times: seconds since the window's first frame, ``(w, f)``.
        begin: clip time of the first frame, ``(w,)``.
        clip: number of the clip, ``(w,)``.
        first: number of the first frame, ``(w,)``.
        mass: ``(w, n)``.
        coupling: ``(w,)``, or ``None``.
        colour: of the noise; ``None`` where it is white.
        fine: nodes over their usual number, see :attr:`usual`; a long window may have fewer, and
            what a close encounter asks for is more.
    """

    frames: np.ndarray
    seen: np.ndarray
    times: np.ndarray
    begin: np.ndarray
    clip: np.ndarray
    first: np.ndarray
    mass: np.ndarray
    coupling: np.ndarray | None
    colour: Colour | None = None
    fine: float = 1.0

    def __len__(self) -> int:
        return len(self.frames)

    def only(self, kept: np.ndarray) -> Windows:
        """Some of the windows, by their numbers ``(k,)``."""
        each = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(
            self, **{name: x[kept] for name, x in each.items() if isinstance(x, np.ndarray)}
        )

    def apart(self) -> Windows:
        """The same with a window for each body."""
        each = np.repeat(np.arange(len(self)), self.seen.shape[2])
        return replace(
            self.only(each),
            frames=apart(self.frames),
            seen=apart(self.seen),
            mass=self.mass.reshape(-1, 1),
        )

    @property
    def length(self) -> np.ndarray:
        """Seconds, ``(w,)``."""
        return self.times[:, -1]

    @property
    def interval(self) -> float:
        """Seconds from frame to frame, the mean."""
        return float(np.diff(self.times).mean())

    @cached_property
    def alike(self) -> bool:
        """Whether all windows have the same times and every body is seen in every frame."""
        return bool(self.seen.all()) and bool(
            np.abs(self.times - self.times[:1]).max() < SAME * self.length.max()
        )

    def inverse(self, design: np.ndarray) -> np.ndarray:
        """Pseudo-inverse of a design ``(w, n, f, k)`` of the times alone, where seen."""
        if self.alike:
            return np.broadcast_to(
                np.linalg.pinv(design[0, 0]), (*design.shape[:2], *design.shape[:1:-1])
            )
        return np.linalg.pinv(design)

    @cached_property
    def panels(self) -> int:
        """Equal parts of a window with nodes of their own."""
        return max(1, self._count // PANEL)

    @cached_property
    def panel(self) -> np.ndarray:
        """Places of a panel's nodes in [-1, 1], both ends among them."""
        count = -(-self._count // self.panels)
        return -np.cos(np.pi * np.arange(count) / (count - 1))

    @property
    def _count(self) -> int:
        """Nodes of a window, about."""
        return max(self._least, int(self.fine * self.usual))

    @property
    def usual(self) -> int:
        """Nodes of a window as a rule."""
        frames = self.frames.shape[1]
        return frames if frames > FEW else self._least

    @property
    def _least(self) -> int:
        return int(np.clip(NODES_PER_FRAME * self.frames.shape[1], *NODES))

    @cached_property
    def nodes(self) -> np.ndarray:
        """Places of the nodes in [-1, 1]; where panels meet are two."""
        middles = 2 * np.arange(self.panels)[:, None] + 1
        return ((middles + self.panel) / self.panels - 1).ravel()

    @cached_property
    def node_times(self) -> np.ndarray:
        """Clip times of the nodes, ``(w, m)``."""
        return self.begin[:, None] + (self.nodes + 1) / 2 * self.length[:, None]

    @cached_property
    def panel_once(self) -> np.ndarray:
        """Integral over [-1, x] of a panel from values at its nodes, ``(k, k)``."""
        raised = chebyshev.chebint(self._to_coefficients, lbnd=-1.0, axis=0)
        return chebyshev.chebval(self.panel, raised).T

    @cached_property
    def in_panel(self) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over a panel's seconds, once and twice, ``(w, k, k)`` each."""
        once = (self.length / (2 * self.panels))[:, None, None] * self.panel_once
        return once, once @ once

    @cached_property
    def _to_coefficients(self) -> np.ndarray:
        """Of Chebyshev polynomials, from values at a panel's nodes, ``(k, k)``."""
        return np.linalg.inv(chebyshev.chebvander(self.panel, len(self.panel) - 1))

    @cached_property
    def once(self) -> np.ndarray:
        """Integral over [-1, x] from values at the nodes, ``(m, m)``."""
        whole = np.tile(self.panel_once[-1], (len(self.panel), 1))
        before = np.tri(self.panels, k=-1)
        own = np.kron(np.eye(self.panels), self.panel_once)
        return (own + np.kron(before, whole)) / self.panels

    def nodes_needed(self, a: np.ndarray, least: float) -> int:
        """Nodes that carry accelerations ``(w, m, ...)`` at the nodes; all where none can go.

        Args:
            a: of a path.
            least: what the others may move a body by at most, world units.
        """
        size = len(self.panel)
        parts = self._to_coefficients @ a.reshape(len(a), self.panels, size, -1)
        seconds = self.length[:, None, None] / (2 * self.panels)
        moved = np.abs(parts).max(-1) * seconds**2  # (w, panels, k)
        moved = moved / np.maximum(np.arange(size), 1) ** 2
        beyond = np.cumsum(moved[..., ::-1], -1)[..., ::-1].max((0, 1))
        return int((beyond > least).sum()) * self.panels

    @cached_property
    def to_frames(self) -> np.ndarray:
        """Values at the frames from values at the nodes, ``(w, f, m)``."""
        place = self.panels * np.clip(self.times / self.length[:, None], 0, 1)
        whose = np.minimum(place.astype(int), self.panels - 1)
        own = chebyshev.chebvander(2 * (place - whose) - 1, len(self.panel) - 1)
        own = own @ self._to_coefficients
        lies = whose[..., None] == np.arange(self.panels)  # (w, f, panels)
        return (lies[..., None] * own[:, :, None]).reshape(*self.times.shape, -1)

    @cached_property
    def tests(self) -> tuple[np.ndarray, np.ndarray]:
        """Test functions ``(w, n, k, f)`` and their ``kicks`` ``(w, n, k)``; zeros are none.

        Worked out once for each pattern of times and seen frames.
        """
        count, size, bodies = self.seen.shape
        rows = np.zeros((count, bodies, size - 2, size))
        kicks = np.zeros((count, bodies, size - 2))
        known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        for window in range(count):
            stamp = np.round(self.times[window], 9).tobytes()
            for body in range(bodies):
                seen = self.seen[window, :, body]
                key = stamp + seen.tobytes()
                if key not in known:
                    known[key] = _tests(self.times[window], seen, self.colour)
                basis, strength = known[key]
                rows[window, body, : len(basis)] = basis
                kicks[window, body, : len(basis)] = strength
        return rows, kicks / self.mass[:, :, None] ** 2

    @cached_property
    def errors(self) -> np.ndarray:
        """Covariance of the frames' errors, of unit variance, ``(w, 1, f, f)``."""
        if self.colour is None:
            size = self.times.shape[1]
            return np.broadcast_to(np.eye(size), (len(self), 1, size, size))
        return self.colour.covariance(self.times)[:, None]

    def whitening(self, ratio: float = 0.0) -> np.ndarray:
        """Matrices that make the frames' errors independent, of unit size, ``(w, n, f, f)``.

        Args:
            ratio: variance of random kicks per second over that of the noise.
        """
        t = self.times
        unseen = np.where(self.seen, 0.0, UNSEEN).transpose(0, 2, 1)[..., None]
        if ratio == 0 and self.colour is None:
            return np.eye(t.shape[1]) / np.sqrt(1 + unseen)
        early, late = np.minimum(t[:, :, None], t[:, None]), np.maximum(t[:, :, None], t[:, None])
        moved = (ratio * early**2 * (3 * late - early) / 6)[:, None]
        covariance = self.errors + moved / self.mass[:, :, None, None] ** 2
        return np.linalg.inv(np.linalg.cholesky(covariance + unseen * np.eye(t.shape[1])))

    @cached_property
    def informative(self) -> np.ndarray:
        """Which rows of the test functions are there, ``(w, n, k)``."""
        return np.abs(self.tests[0]).sum(-1) > 0

    @cached_property
    def measured(self) -> np.ndarray:
        """What the test functions read from the frames, ``(w, n, k, d)``."""
        return self.tests[0] @ self.frames.transpose(0, 2, 1, 3)

    @cached_property
    def weak(self) -> np.ndarray:
        """What they read from accelerations at the nodes, ``(w, n, k, m)``."""
        scale = (self.length / 2) ** 2
        twice = self.to_frames @ (self.once @ self.once) * scale[:, None, None]
        return self.tests[0] @ twice[:, None]

    def read(self, accelerations: np.ndarray) -> np.ndarray:
        """Weak form of accelerations ``(w, m, n, ...)`` at the nodes, ``(w, n, k, ...)``."""
        moved = np.moveaxis(accelerations, 2, 1)
        flat = moved.reshape(*moved.shape[:3], -1)
        out = self.weak @ flat
        return out.reshape(*out.shape[:3], *moved.shape[3:])


def _tests(
    times: np.ndarray, seen: np.ndarray, colour: Colour | None
) -> tuple[np.ndarray, np.ndarray]:
    """Test functions on the frames that were seen, and the variance that unit kicks give each."""
    if seen.sum() < LEAST:
        return np.zeros((0, len(times))), np.zeros(0)
    t = times[seen]
    straight = np.stack([np.ones_like(t), t], 1)
    free = np.linalg.qr(straight, mode="complete")[0][:, 2:].T
    if colour is not None:
        covariance = free @ colour.covariance(t) @ free.T
        free = np.linalg.solve(np.linalg.cholesky(covariance), free)
    early, late = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    spread = early**2 * (3 * late - early) / 6  # covariance of white noise integrated twice
    strength, turn = np.linalg.eigh(free @ spread @ free.T)
    rows = np.zeros((len(free), len(times)))
    rows[:, seen] = (turn.T @ free)[::-1]
    return rows, strength[::-1]


def cut_windows(motion: Motion, frames: int, fine: float = 1.0) -> Windows:
    """Cut every clip into neighbouring windows of about ``frames`` frames, all of one size.

    Args:
        motion: whose clips they are.
        frames: of a window.
        fine: see :class:`Windows`.

    Raises:
        Unseen: in none of them all bodies are seen.
    """
    total = motion.positions.shape[1]
    pieces = max(1, total // frames)
    if total // pieces > STRETCH * frames:
        pieces += 1
    size = total // pieces
    firsts = np.arange(pieces) * size + (total - pieces * size) // 2
    clip, first = (x.ravel() for x in np.meshgrid(np.arange(motion.clips), firsts, indexing="ij"))
    return replace(windows_at(motion, clip, first, size), fine=fine)


def windows_at(motion: Motion, clip: np.ndarray, first: np.ndarray, size: int) -> Windows:
    """Windows of ``size`` frames that begin at given frames of given clips.

    Without those in which a body is hardly seen: nobody knows what it did to the others there.

    Raises:
        Unseen: there are no others.
    """
    reach = np.arange(size)
    seen = motion.seen[clip[:, None], first[:, None] + reach]
    told = (seen.sum(1) >= LEAST).all(-1)
    if not told.any():
        raise Unseen(
            f"no stretch of {size} frames shows each body {LEAST} times; follow fewer bodies, or "
            "use a part of the recording that shows them all"
        )
    clip, first, seen = clip[told], first[told], seen[told]
    at = clip[:, None], first[:, None] + reach
    positions, times = motion.positions[at], motion.times[at]
    coupling = None if motion.coupling is None else motion.coupling[clip]
    return Windows(
        np.where(seen[..., None], positions, 0.0),
        seen,
        times - times[:, :1],
        times[:, 0],
        clip,
        first,
        motion.mass[clip],
        coupling,
        motion.colour,
    )
