"""Shorter steps where a close encounter needs them, and nowhere else; symmetric in time.

A step is taken as it is if the fastest term on its way turns by little: omega * dt, at the closest
approach on the straight line between its ends, a number that is the same from either end. Else it
is two of half the length, each judged in the same way. What is accepted at full length is the
integrator's own step, bit for bit.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics.checks import named
from dynamics.findings import Finding, StabilityWarning, counted
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head
from dynamics.integrators import Memory, kahan_li8
from dynamics.stability import ConstantRates, Rates, Stiffest, flat_parameters, rates_of, stiffest
from dynamics.state import Parameters, PhaseState

# omega * dt that an integrator of second order resolves everywhere to a percent; a model that can
# never exceed it at this dt is not watched.
RESOLVED = 0.25
LIMIT = {2: 0.05, 4: 0.1}  # order, or at least -> omega * dt of a step that is left whole
MAX_PIECES = 1024  # of one step; an episode that needs more is left to fixed steps from then on
MAX_HALVINGS = 45


def watched(head: Head, start: PhaseState, params: Parameters, dt: float) -> list[Rates]:
    """The rates of a model whose fastest term this ``dt`` may not resolve; else none.

    Args:
        head: any.
        start: of the rollout, ``(..., n, d)``.
        params: of its episodes.
        dt: seconds.

    Returns:
        Rates of the flat batch of episodes.
    """
    batch = start.q.shape[:-2]
    if not batch.numel():
        return []
    rates = rates_of(head, start, flat_parameters(params, batch))
    fastest = [float(rate.worst().amax()) for rate in rates]
    return rates if any(squared * dt * dt > RESOLVED**2 for squared in fastest) else []


class Substepper:
    """Steps of a Hamiltonian model, in pieces where its terms need them.

    Attributes:
        pieces: steps of a part of ``dt`` that were taken, over all groups of episodes.
        split: steps of single episodes that were taken in pieces.
        unresolved: episodes that would have needed more pieces than are allowed, flat.
        steepest: the fastest term of the first of those, as it was met.
    """

    def __init__(self, head: Hamiltonian, rates: list[Rates], start: PhaseState) -> None:
        self.head, self.rates, self.batch = head, rates, start.q.shape[:-2]
        # A port's flow has a direction in time: the fine method's backward steps are not for it.
        self.composed = head.integrator.needs_separable and not len(head.ports)
        self.limit = LIMIT[min(head.integrator.order, 4)] if self.composed else RESOLVED
        self.fine_limit = LIMIT[4] if self.composed else RESOLVED
        self.pieces, self.left, self.split = 0, 0, 0
        everyone = self.batch.numel()
        self.unresolved = torch.zeros(everyone, dtype=torch.bool, device=start.q.device)
        self.steepest: Stiffest | None = None

    @classmethod
    def of(cls, head: Head, rates: list[Rates], start: PhaseState) -> Substepper | None:
        """For a model whose steps can be taken apart; ``None`` for others."""
        if isinstance(head, Hamiltonian) and head.integrator.restarts:
            return cls(head, rates, start)
        return None

    def findings(self) -> list[Finding]:
        """Which episodes were not resolved, and by what."""
        if self.steepest is None:
            return []
        episodes = self.unresolved.reshape(self.batch)
        term, pair = self.steepest.term, self.steepest.pair.reshape(-1, 2)[0].tolist()
        text = (
            f"{named(term, pair)} turns by {float(self.steepest.rate.max()):.2g} radians a second "
            f"in {counted(episodes)}: more pieces of a step than {MAX_PIECES} would resolve it, "
            "which were not taken; use a smaller dt or a larger softening"
        )
        return [Finding(StabilityWarning, text, episodes, term=term)]

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory
    ) -> tuple[PhaseState, Memory]:
        """One step of ``dt`` seconds; what the head would do, where that is fine enough."""
        after, kept = self.head.advance(state, params, dt, memory)
        flat, end = self._flat(state), self._flat(after)
        coarse = self._coarse(flat.q, end.q, self.rates, dt, self.limit) & ~self.unresolved
        if not bool(coarse.any()):
            return after, kept
        who = coarse.nonzero().squeeze(-1)
        if self._hopeless(dt):
            self._give_up(flat.q[who], who)
            return after, kept
        self.left = MAX_PIECES
        self.split += len(who)
        law = flat_parameters(params, self.batch)[who]
        found = self._halved(flat[who], law, dt, who, 1)
        self.pieces += MAX_PIECES - self.left
        merged = PhaseState(end.q.index_copy(0, who, found.q), end.p.index_copy(0, who, found.p))
        # Nothing is handed on, so that the next step begins from the merged state.
        return merged.map(lambda x: x.reshape(state.q.shape)), None

    def _halved(
        self, state: PhaseState, params: Parameters, dt: float, who: Tensor, halvings: int
    ) -> PhaseState:
        for _ in range(2):
            state = self._fine(state, params, dt / 2, who, halvings)
        return state

    def _fine(
        self, state: PhaseState, params: Parameters, dt: float, who: Tensor, halvings: int
    ) -> PhaseState:
        """One piece for each episode, or two of half the length for those that need it."""
        rates = [rate.of(who) for rate in self.rates]
        spent = self.left <= 0 or halvings >= MAX_HALVINGS
        # The way of a step holds its start: where all starts are too steep, no piece is tried.
        if not spent and bool(self._coarse(state.q, state.q, rates, dt, self.fine_limit).all()):
            return self._halved(state, params, dt, who, halvings + 1)
        self.left -= 1
        after = self._piece(state, params, dt)
        coarse = self._coarse(state.q, after.q, rates, dt, self.fine_limit).nonzero().squeeze(-1)
        if not len(coarse):
            return after
        if spent:
            self._give_up(state.q[coarse], who[coarse])
            return after
        part = self._halved(state[coarse], params[coarse], dt, who[coarse], halvings + 1)
        return PhaseState(
            after.q.index_copy(0, coarse, part.q), after.p.index_copy(0, coarse, part.p)
        )

    def _hopeless(self, dt: float) -> bool:
        """Whether a term that is as fast everywhere needs more pieces than are allowed."""
        constant = [rate.worst().amax() for rate in self.rates if isinstance(rate, ConstantRates)]
        return any(float(x) * dt * dt > (MAX_PIECES * self.fine_limit) ** 2 for x in constant)

    def _piece(self, state: PhaseState, params: Parameters, dt: float) -> PhaseState:
        if self.composed:
            return kahan_li8(self.head.field(params), state, dt)
        return self.head.advance(state, params, dt)[0]

    @staticmethod
    def _coarse(q: Tensor, end: Tensor, rates: list[Rates], dt: float, limit: float) -> Tensor:
        """Whose fastest term turns by more than ``limit`` on the way; never where it is NaN."""
        squared = [rate.between(q, end) for rate in rates]
        fastest = squared[0] if len(squared) == 1 else torch.stack(squared).amax(0)
        return fastest > (limit / dt) ** 2

    def _give_up(self, q: Tensor, who: Tensor) -> None:
        self.unresolved[who] = True
        if self.steepest is None:
            self.steepest = stiffest([rate.of(who) for rate in self.rates], q)

    @staticmethod
    def _flat(state: PhaseState) -> PhaseState:
        return state.map(lambda x: x.reshape(-1, *x.shape[-2:]))
