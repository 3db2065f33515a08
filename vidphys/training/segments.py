"""Training examples of a dynamics head: a start state and where it went next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics import Head, Parameters, PhaseState, Rollout
from vidphys.placement import moved
from vidphys.shooting.step import roll


@dataclass(frozen=True)
class Segments:
    """Short stretches of trajectories, flattened over episodes.

    Targets are increments from the start, taken in float64 before rounding to float32: over one
    step they are a thousandth of the state.

    Args:
        start: ``(m, n, d)``.
        params: ``(m,)`` and ``(m, n)``.
        q: position increments at each later stored state, ``(m, k, n, d)``.
        p: momentum increments, or ``None`` where only positions were seen.
        dt: seconds of one model step.
        every: model steps between stored states.
    """

    start: PhaseState
    params: Parameters
    q: Float[Tensor, "m k n d"]
    p: Float[Tensor, "m k n d"] | None
    dt: float
    every: int

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, index: Tensor | slice) -> Segments:
        def cut(x: Tensor) -> Tensor:
            # Not x[index]: torch gathers even a few numbers by all its threads, which then spin.
            return x[index] if isinstance(index, slice) else x.index_select(0, index.to(x.device))

        p = None if self.p is None else cut(self.p)
        start, params = self.start.map(cut), self.params.map(cut)
        return Segments(start, params, cut(self.q), p, self.dt, self.every)

    def to(self, device: str) -> Segments:
        """The same examples on another device."""
        return moved(self, device)

    def split(self, held_out: int) -> tuple[Segments, Segments]:
        """All but the last ``held_out`` examples, and those."""
        return self[slice(0, len(self) - held_out)], self[slice(len(self) - held_out, None)]


def from_trajectory(trajectory: Rollout, k: int, every: int = 1, step: int = 1) -> Segments:
    """Segments of ``k`` stored states starting at each ``step``-th state of ``(b, t, n, d)``.

    Args:
        trajectory: its ``dt`` is ``every`` model steps.
        k: later states a segment holds.
        every: model steps between stored states.
        step: stored states between segment starts.

    Example:
        >>> from torch import Generator
        >>> from vidphys.scenes import gravity
        >>> scene = gravity()
        >>> truth = scene.simulate(*scene.sample(4, Generator().manual_seed(0)), steps=20)
        >>> data = from_trajectory(truth, k=1)
        >>> len(data), tuple(data.q.shape)  # of 4 episodes, 20 starts each
        (80, (80, 1, 3, 2))
    """
    states = trajectory.states.map(torch.Tensor.double)
    starts = range(0, states.q.shape[1] - k, step)

    def windows(x: Tensor) -> Tensor:
        cut = torch.stack([x[:, s + 1 : s + 1 + k] - x[:, s : s + 1] for s in starts], 1)
        return cut.flatten(0, 1).float()

    start = states.map(lambda x: x[:, list(starts)].flatten(0, 1).float())
    repeated = trajectory.params.map(lambda x: x.float().repeat_interleave(len(starts), 0))
    dt = trajectory.dt / every
    return Segments(start, repeated, windows(states.q), windows(states.p), dt, every)


@dataclass(frozen=True)
class Scale:
    """Sizes of the first stored increments.

    Args:
        q, p: standard deviations.
        p_small: size below which only a twentieth of the bodies' momentum increments lie; those
            of bodies on which no force acts at all are not counted.
    """

    q: float
    p: float
    p_small: float


def scale_of(segments: Segments) -> Scale:
    """Sizes that standardise a loss; p falls back to 1 where momentum was not seen."""
    q = float(segments.q[:, 0].std())
    if segments.p is None:
        return Scale(q, 1.0, 1.0)
    first = segments.p[:, 0]
    sizes = first.norm(dim=-1).flatten().sort().values
    sizes = sizes[sizes > 0]
    if not len(sizes):
        return Scale(q, 1.0, 1.0)
    return Scale(q, float(first.std()), float(sizes[len(sizes) // 20]))


def segment_loss(head: Head, scale: Scale) -> Callable[[Segments], Tensor]:
    """Mean squared standardised error of the rolled-out increments, one step or k steps."""

    def loss(batch: Segments) -> Tensor:
        return increment_error(predict(head, batch), batch, scale)

    return loss


def predict(head: Head, batch: Segments) -> PhaseState:
    """The head's states at the stored steps, ``(m, k, n, d)``."""
    return roll(head, batch.start, batch.params, batch.q.shape[-3], batch.dt, batch.every)


def increment_error(states: PhaseState, batch: Segments, scale: Scale) -> Tensor:
    """Standardised error of predicted states against a batch's increments.

    Momentum errors are relative to each body's own increment (or to a small one, where its
    own is smaller): otherwise a few encounters would outweigh the whole far field, which is what
    long rollouts need.
    """
    start = batch.start.map(lambda x: x.unsqueeze(-3))
    total = (((states.q - start.q) - batch.q) / scale.q).square().mean()
    if batch.p is not None:
        size = batch.p.square().sum(-1, keepdim=True) + scale.p_small**2
        total = total + (((states.p - start.p) - batch.p).square() / size).mean()
    return total


def standardise(head: Head, segments: Segments) -> None:
    """Tell a head the size of one step's increments, and the states that it is trained on."""
    scale = scale_of(segments)
    head.set_scale(scale.q / segments.every, scale.p / segments.every)
    head.see(segments.start)
