"""Bodies bound to curves: the state is in the picture, and the law moves them along."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from dynamics.curves import Curve
from dynamics.domain import MOMENTUM, ORIGIN
from dynamics.findings import Finding
from dynamics.head import Head, Trajectory
from dynamics.integrators import Memory
from dynamics.state import Parameters, PhaseState


class Bound(Head):
    """A model of coordinates on a curve, seen where the curve puts them.

    A state holds places in the picture and p = m dq/dt, as of any bodies there. It is taken to the
    curve, to (s, m ds/dt), and stepped in s; energy and friction are those of the law. A rollout
    stays in s from its start on.

    Args:
        curve: where the bodies may be.
        law: of as many bodies, in the one dimension along it.

    Example:
        >>> import torch
        >>> from dynamics import ballistic
        >>> from dynamics.curves import Arc
        >>> wheel = Bound(Arc((0.0, 0.0), (1.0, 0.0), (0.0, -1.0)), ballistic())
        >>> start = PhaseState(torch.tensor([[[0.0, -1.0]]]), torch.tensor([[[torch.pi, 0.0]]]))
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1))
        >>> later, _ = wheel.advance(start, law, dt=0.5)  # a quarter turn
        >>> torch.allclose(later.q, torch.tensor([1.0, 0.0]), atol=1e-4)
        True
    """

    def __init__(self, curve: Curve, law: Head) -> None:
        super().__init__()
        self.curve, self.law = curve, law

    def inward(self, state: PhaseState, params: Parameters) -> PhaseState:
        """From the picture ``(..., n, d)`` to the curve ``(..., n, 1)``."""
        s, mass = self.curve.coordinate(state.q), params.mass.unsqueeze(-1)
        return PhaseState(s, mass * self.curve.rate(s, state.p / mass))

    def outward(self, state: PhaseState, mass: Float[Tensor, "*b n"]) -> PhaseState:
        """Inverse of :meth:`inward`, but for what is not on the curve."""
        mass = mass.unsqueeze(-1)
        velocity = self.curve.velocity(state.q, state.p / mass)
        return PhaseState(self.curve.place(state.q), mass * velocity)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        # The law's memory is not handed on, as it knows nothing of whole turns: only the time is.
        gone = memory or 0.0
        state, _ = self.law.advance(self.inward(state, params), params.later(gone), dt)
        return self.outward(state, params.mass), gone + dt

    def trajectory(
        self, start: PhaseState, params: Parameters, steps: int, dt: float, every: int = 1
    ) -> Trajectory:
        found = self.law.trajectory(self.inward(start, params), params, steps, dt, every)
        states = self.outward(found.states, params.mass.unsqueeze(-2))
        return Trajectory(states, found.backend, found.fallbacks)

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        """Of the law along the curve; a curve does no work."""
        inside: Tensor = self.law.energy(self.inward(state, params), params)  # type: ignore[operator]
        return inside

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """What moves the bodies along; not what holds them on the curve."""
        inside = self.inward(state, params)
        return self.curve.pull(inside.q, self.law.force(inside, params))

    def check(self, params: Parameters) -> None:
        self.law.check(params)

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        inside = None if start is None else self.inward(start, params)
        return self.law.concerns(params, inside)

    @property
    def conserves(self) -> bool:
        return self.law.conserves

    @property
    def depends_on(self) -> tuple[str, ...]:
        # of a learned law, what can be seen of its own extents from the picture
        return (ORIGIN, MOMENTUM) if self.law.depends_on else ()
