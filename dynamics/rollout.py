"""Rolling a model forward, with a verdict on each episode instead of silent NaN."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from dynamics.head import Head
from dynamics.state import Parameters, PhaseState

NO_BAD_STEP = -1


@dataclass(frozen=True)
class Rollout:
    """A trajectory that includes its start: ``steps / every + 1`` stored states.

    Args:
        states: ``(..., t, n, d)``.
        params: what the law was told, batch axes of the start.
        dt: seconds between stored states.
        first_bad: per episode, index of the first stored state that is not finite, or -1.
        seed: of a stochastic head's noise, where one was given.
    """

    states: PhaseState
    params: Parameters
    dt: float
    first_bad: Tensor
    seed: int | None = None

    @property
    def finite(self) -> Tensor:
        """Which episodes stayed finite throughout, boolean, batch shape."""
        return self.first_bad == NO_BAD_STEP

    @property
    def times(self) -> Tensor:
        """Seconds since the start of each stored state, ``(t,)``."""
        return torch.arange(self.states.q.shape[-3], dtype=torch.float64) * self.dt

    def at(self, index: int) -> PhaseState:
        """The stored state at a time index."""
        return self.states.map(lambda x: x[..., index, :, :])


def rollout(
    head: Head,
    start: PhaseState,
    params: Parameters,
    steps: int,
    dt: float,
    every: int = 1,
    seed: int | None = None,
) -> Rollout:
    """Roll ``steps`` steps of ``dt`` seconds from ``start``, storing each ``every``-th state.

    No gradient is recorded. A fork into another law is another call:
    ``rollout(head, r.at(t), r.params.with_coupling(-1.0), steps, dt)``.

    Args:
        seed: of a stochastic head's noise, which is drawn from torch's global generator; that
            generator is left as it was. ``None`` draws on from where it is.

    Raises:
        ValueError: ``steps`` is not a multiple of ``every``, the start is not finite, or the head
            refuses the parameters.
    """
    if steps < 0 or every < 1:
        raise ValueError(f"rollout: needs steps >= 0 and every >= 1, got {steps} and {every}")
    if steps % every:
        raise ValueError(f"rollout: steps = {steps} is not a multiple of every = {every}")
    if not bool(torch.isfinite(start.flat).all()):
        bad = torch.nonzero(~torch.isfinite(start.flat))[0].tolist()
        raise ValueError(f"rollout: the start state is not finite (first at flat index {bad})")
    head.check(params)
    stored, state, memory = [start], start, None
    with torch.no_grad(), _noise(seed, start.q.device):
        for step in range(1, steps + 1):
            state, memory = head.advance(state, params, dt, memory)
            if step % every == 0:
                stored.append(state)
        states = PhaseState.stack(stored, -3)
    return Rollout(states, params, dt * every, first_bad_step(states), seed)


@contextmanager
def _noise(seed: int | None, device: torch.device) -> Iterator[None]:
    """Draw from a generator of this seed, and give the global one back untouched."""
    if seed is None:
        yield
        return
    with torch.random.fork_rng([device] if device.type == "cuda" else []):
        torch.manual_seed(seed)
        yield


def first_bad_step(states: PhaseState) -> Tensor:
    """Per episode, the first time index at which a state is not finite, or -1."""
    bad = ~torch.isfinite(states.flat).all(-1)
    return torch.where(bad.any(-1), bad.int().argmax(-1), NO_BAD_STEP)
