"""Rolling a model forward, with a verdict on each episode instead of silent NaN."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dynamics import checks
from dynamics.findings import Finding
from dynamics.head import Head, Report, Trajectory, stepped
from dynamics.state import Parameters, PhaseState
from dynamics.substeps import Substepper, watched

NO_BAD_STEP = -1


OK, WARNED, FAILED = "ok", "warned", "failed"


@dataclass(frozen=True)
class Rollout:
    """A trajectory that includes its start: ``steps / every + 1`` stored states.

    Args:
        states: ``(..., t, n, d)``.
        params: what the law was told, batch axes of the start.
        dt: seconds between stored states.
        first_bad: per episode, index of the first stored state that is not finite, or -1.
        seed: of a stochastic head's noise, where one was given.
        findings: what is wrong with it; each was also warned of.
        pieces: steps of a part of ``dt`` that close encounters needed.
        split: steps of single episodes that were taken in such pieces.
        backend: what computed it, see :class:`dynamics.head.Trajectory`.
        fallbacks: pairs at which a compiled model asked its network, over all steps.
        report: of the spline that stood for a network; ``None`` where the model itself was rolled.
    """

    states: PhaseState
    params: Parameters
    dt: float
    first_bad: Int[Tensor, "*b"]
    seed: int | None = None
    findings: tuple[Finding, ...] = ()
    pieces: int = 0
    backend: str = "torch"
    fallbacks: int = 0
    split: int = 0
    report: Report | None = None

    @property
    def finite(self) -> Bool[Tensor, "*b"]:
        """Which episodes stayed finite throughout, boolean, batch shape."""
        return self.first_bad == NO_BAD_STEP

    @property
    def status(self) -> str:
        """``failed`` if an episode is not finite, ``warned`` if there is a finding, else ``ok``."""
        if not bool(self.finite.all()):
            return FAILED
        return WARNED if self.findings else OK

    @property
    def times(self) -> Float[Tensor, " t"]:
        """Seconds since the start of each stored state, ``(t,)``, on the CPU."""
        return torch.arange(self.states.q.shape[-3], dtype=torch.float64, device="cpu") * self.dt

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
    substeps: bool = True,
) -> Rollout:
    """Roll ``steps`` steps of ``dt`` seconds from ``start``, storing each ``every``-th state.

    No gradient is recorded. A fork into another law is another call:
    ``rollout(head, r.at(t), r.params.with_coupling(-1.0), steps, dt)``. Of a law that changes with
    time :meth:`.Parameters.later` sets the clock on.

    Args:
        seed: of a stochastic head's noise, which is drawn from torch's global generator; that
            generator is left as it was. ``None`` draws on from where it is.
        substeps: whether a step that does not resolve the fastest pair is taken in pieces
            (:mod:`dynamics.substeps`); all others are the integrator's own, bit for bit.

    Raises:
        ValueError: ``steps`` is not a multiple of ``every``, a number is not finite, the state is
            of less than single precision or of another than the head's networks, the parameters
            are of other bodies or episodes, or the head refuses them.

    Warns:
        DynamicsWarning: one of its kinds for each finding, before the result is returned.

    Example:
        >>> from dynamics import ballistic
        >>> start = PhaseState(torch.zeros(1, 1, 2), torch.ones(1, 1, 2))
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1))
        >>> found = rollout(ballistic(), start, law, steps=100, dt=0.01, every=50)
        >>> found.times.tolist(), found.status
        ([0.0, 0.5, 1.0], 'ok')
        >>> [round(x, 3) for x in found.at(-1).q.flatten().tolist()]
        [1.0, 1.0]
    """
    if steps < 0 or every < 1:
        raise ValueError(f"rollout: needs steps >= 0 and every >= 1, got {steps} and {every}")
    if steps % every:
        raise ValueError(f"rollout: steps = {steps} is not a multiple of every = {every}")
    checks.start(start, params, dt)
    checks.same_precision(head, start, params)
    head.check(params)
    findings = head.concerns(params, start)
    with torch.no_grad(), _noise(seed, start.q.device):
        rates = watched(head, start, params, dt)
        stepper = Substepper.of(head, rates, start) if substeps and rates else None
        if rates and stepper is None:
            findings += checks.fixed_step(rates, PhaseState.stack([start], -3), dt, every)
        for finding in findings:
            finding.warn()
        if stepper is None:
            path = head.trajectory(start, params, steps, dt, every)
        else:
            path = Trajectory(stepped(stepper.advance, start, params, steps, dt, every))
        states = path.states
        first_bad = first_bad_step(states, path.reached)
        found = [
            *checks.failure(head, states, params, first_bad, dt, every),
            *checks.energy(head, states, params, every, bool(rates)),
            *checks.domain(head, states, every, path.reached),
            *checks.rounding(states, every),
        ]
        if stepper is not None:
            found += stepper.findings()
        elif rates and not findings:
            found += checks.fixed_step(rates, states, dt, every)
    for finding in found:
        finding.warn()
    pieces, split = (stepper.pieces, stepper.split) if stepper else (0, 0)
    said = (*findings, *found)
    ran = path.backend, path.fallbacks
    more = pieces, *ran, split, head.report
    return Rollout(states, params, dt * every, first_bad, seed, said, *more)


@contextmanager
def _noise(seed: int | None, device: torch.device) -> Iterator[None]:
    """Draw from a generator of this seed, and give the global one back untouched."""
    if seed is None:
        yield
        return
    with torch.random.fork_rng([device] if device.type == "cuda" else []):
        torch.manual_seed(seed)
        yield


def first_bad_step(
    states: PhaseState, reached: dict[str, float] | None = None
) -> Int[Tensor, "*b"]:
    """Per episode, the first time index at which a state is not finite, or -1.

    Args:
        states: ``(..., t, n, d)``.
        reached: see :class:`dynamics.head.Trajectory`.
    """
    # A sum that is finite has finite terms, at a tenth of the cost of looking at each.
    total = float(states.q.sum() + states.p.sum()) if reached is None else sum(reached.values())
    if math.isfinite(total):
        batch = states.q.shape[:-3]
        return torch.full(batch, NO_BAD_STEP, device=states.q.device)
    bad = ~torch.isfinite(states.flat).all(-1)
    return torch.where(bad.any(-1), bad.int().argmax(-1), NO_BAD_STEP)
