"""What every dynamics head offers, learned or exact."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.domain import EXTENTS, UNKNOWN, extents
from dynamics.findings import Finding
from dynamics.integrators import Memory
from dynamics.state import Parameters, PhaseState


@dataclass(frozen=True)
class Trajectory:
    """The states of a rollout ``(..., t, n, d)``, and how they came about.

    Args:
        states: the start first.
        backend: what computed them: ``torch``, ``numba``, ``triton`` or ``cuda graph``.
        fallbacks: pairs at which a compiled model asked its network, over all steps.
        reached: the largest of some :data:`dynamics.domain.EXTENTS` of any state on the way, stored
            or not; not finite where one is not; ``None`` where it was not looked at.
    """

    states: PhaseState
    backend: str = "torch"
    fallbacks: int = 0
    reached: dict[str, float] | None = None


@dataclass(frozen=True)
class Report:
    """What a spline was built for, and what it reached.

    Args:
        tolerance: of the force, as it was asked for.
        error: as it was measured in the model's floating type; both are of
            :class:`dynamics.compiled.build.Sample`.
        resolution: of the spline, see its class.
        reach: world units up to which it stands for the network.
        size: bytes of its table in that type.
    """

    tolerance: float
    error: float
    resolution: int
    reach: float
    size: int


Advance = Callable[[PhaseState, Parameters, float, Memory], tuple[PhaseState, Memory]]


def stepped(
    advance: Advance, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> PhaseState:
    """Step by step from ``start``, each ``every``-th state stored, ``(..., t, n, d)``."""
    stored, state, memory = [start], start, None
    for step in range(1, steps + 1):
        state, memory = advance(state, params, dt, memory)
        if step % every == 0:
            stored.append(state)
    return PhaseState.stack(stored, -3)


# (head, start, params, steps, dt, every) -> what stepping one by one gives, or None where it
# knows no such states or device; of the heads, it is given those of its class alone.
Engine = Callable[[Any, PhaseState, Parameters, int, float, int], Trajectory | None]


class Head(nn.Module, ABC):
    """A law that can be stepped.

    Attributes:
        engine: of the class: a faster way to a trajectory, see :mod:`dynamics.engines`.
        dt: seconds of one application of a transition map, which has no other step; ``None``
            for a vector field, which may be stepped by any.
        domain: the largest :func:`dynamics.domain.extents` of the states it was trained on.
        report: of a spline that stands for its network; ``None`` where it rolls by itself.
    """

    engine: ClassVar[Engine | None] = None
    dt: float | None = None
    domain: Tensor
    report: Report | None = None

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("domain", torch.full((len(EXTENTS),), UNKNOWN))

    @abstractmethod
    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        """One step of ``dt`` seconds; ``memory`` is what the last step handed over."""

    def trajectory(
        self, start: PhaseState, params: Parameters, steps: int, dt: float, every: int = 1
    ) -> Trajectory:
        """All steps of a rollout: by the engine where it can, else one by one.

        Args:
            start: ``(..., n, d)``.
            params: of its episodes.
            steps: a multiple of ``every``.
            dt: seconds of a step.
            every: steps between stored states.

        Raises:
            ValueError: a transition map or a compiled model cannot run so; why is said.
        """
        engine = type(self).engine
        found = engine(self, start, params, steps, dt, every) if engine else None
        return self.plain_trajectory(start, params, steps, dt, every) if found is None else found

    def plain_trajectory(
        self, start: PhaseState, params: Parameters, steps: int, dt: float, every: int = 1
    ) -> Trajectory:
        """:meth:`trajectory` by torch's own operations, step by step."""
        return Trajectory(stepped(self.advance, start, params, steps, dt, every))

    @abstractmethod
    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """dp/dt of the conservative part; of a map, all that it adds to p per second."""

    def check(self, params: Parameters) -> None:
        """Refuse parameters under which the model means nothing; a rollout asks before it starts.

        Raises:
            ValueError: what is impossible, and what to do.
        """

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        """What must be said of a rollout under these parameters, from here, before it starts."""
        return []

    def set_scale(self, q: float, p: float) -> None:
        """Be told the sizes of one step's increments; most heads have no use for them."""

    @property
    def conserves(self) -> bool:
        """Whether the model's own energy is constant in time."""
        return False

    @property
    def box(self) -> float | None:
        """Side of the periodic box that its pair laws live in."""
        return None

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Which of :data:`dynamics.domain.EXTENTS` its learned parts are functions of."""
        return EXTENTS

    def see(self, states: PhaseState) -> None:
        """Remember how far the states reach that it is trained on, ``(..., n, d)``."""
        whole = extents(states, self.box).reshape(-1, len(EXTENTS))
        self.domain = whole.amax(0).to(self.domain)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        # Weights of before domains were kept: nothing is known of their training.
        state_dict.setdefault(f"{prefix}domain", torch.full((len(EXTENTS),), UNKNOWN, device="cpu"))
        super()._load_from_state_dict(state_dict, prefix, *rest)
