"""The two types that every dynamics function takes and returns.

Axis names used across the project: ``b`` batch (episodes), ``t`` time, ``n`` bodies, ``d`` space.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

CLOCK = "clock"  # scalar: seconds that a clock shows, of a law that changes with time


@dataclass(frozen=True)
class PhaseState:
    """A point (or a batch, or a trajectory) of phase space.

    Args:
        q: positions, ``(..., n, d)``, in world units.
        p: conjugate momenta, ``(..., n, d)``, in mass units times world units per second.

    Example:
        >>> state = PhaseState(torch.zeros(8, 3, 2), torch.ones(8, 3, 2))  # 8 episodes of 3 bodies
        >>> tuple(state.flat.shape), tuple(state[0].q.shape), float(state.reversed.p.sum())
        ((8, 12), (3, 2), -48.0)
    """

    q: Float[Tensor, "*batch n d"]
    p: Float[Tensor, "*batch n d"]

    def __post_init__(self) -> None:
        if self.q.shape != self.p.shape:
            raise ValueError(
                f"PhaseState: q and p must have one shape, got {tuple(self.q.shape)} "
                f"and {tuple(self.p.shape)}"
            )

    @property
    def flat(self) -> Float[Tensor, "*batch x"]:
        """The concatenated state vector (q, p), shape ``(..., 2 * n * d)``."""
        return torch.cat([self.q.flatten(-2), self.p.flatten(-2)], dim=-1)

    @classmethod
    def from_flat(cls, x: Float[Tensor, "*batch x"], bodies: int, space: int = 2) -> PhaseState:
        """Inverse of :attr:`flat`."""
        both = x.reshape(*x.shape[:-1], 2, bodies, space)
        return cls(both[..., 0, :, :], both[..., 1, :, :])

    def map(self, function: Callable[[Tensor], Tensor]) -> PhaseState:
        """Apply one tensor function to q and to p."""
        return PhaseState(function(self.q), function(self.p))

    def __getitem__(self, index: Any) -> PhaseState:
        return self.map(lambda x: x[index])

    @property
    def reversed(self) -> PhaseState:
        """The time-reversed state: the same place, the opposite momentum."""
        return PhaseState(self.q, -self.p)

    @staticmethod
    def stack(states: list[PhaseState], dim: int) -> PhaseState:
        """Stack states along a new axis ``dim`` (counted from the front of the batch axes)."""
        return PhaseState(
            torch.stack([s.q for s in states], dim), torch.stack([s.p for s in states], dim)
        )


@dataclass(frozen=True)
class Parameters:
    """What the law is told about an episode, and what a counterfactual changes.

    Args:
        coupling: the strength G of the law, ``(...)``; its sign is what inversion flips.
        mass: body masses, ``(..., n)``.
        charge: body charges, ``(..., n)``, where the scene has any.
        scalars: further strengths by name, ``(...)`` each: ``electric`` (the coupling of the
            charges), ``friction`` (per second), ``drive`` (per second), ``temperature`` (k_B = 1).
            ``clock`` (seconds that a clock shows at the state, where the law changes with time).
            A scene has those that its law needs and no others.

    Example:
        >>> law = Parameters(coupling=torch.ones(8), mass=torch.ones(8, 3))
        >>> flipped = law.with_coupling(-1.0)
        >>> float(law.coupling[0]), float(flipped.coupling[0]), tuple(law.flat.shape)
        (1.0, -1.0, (8, 4))
    """

    coupling: Float[Tensor, "*batch"]
    mass: Float[Tensor, "*batch n"]
    charge: Float[Tensor, "*batch n"] | None = None
    scalars: dict[str, Tensor] = field(default_factory=dict)

    @property
    def flat(self) -> Float[Tensor, "*batch c"]:
        """(G, masses, charges, scalars by name) as one vector, the form that networks are given."""
        parts = [self.coupling.unsqueeze(-1), self.mass]
        if self.charge is not None:
            parts.append(self.charge)
        parts += [self.scalars[name].unsqueeze(-1) for name in sorted(self.scalars)]
        return torch.cat(parts, dim=-1)

    def map(self, function: Callable[[Tensor], Tensor]) -> Parameters:
        charge = None if self.charge is None else function(self.charge)
        scalars = {name: function(value) for name, value in self.scalars.items()}
        return Parameters(function(self.coupling), function(self.mass), charge, scalars)

    @staticmethod
    def cat(parts: Sequence[Parameters]) -> Parameters:
        """Episodes one after the other; all have charges and the same scalars, or none has.

        Example:
            >>> one = Parameters(torch.ones(2), torch.ones(2, 3)).with_scalar("friction", 0.1)
            >>> tuple(Parameters.cat([one, one]).scalar("friction").shape)
            (4,)
        """
        first = parts[0]
        charges = [part.charge for part in parts if part.charge is not None]
        if len(charges) not in (0, len(parts)):
            raise ValueError("Parameters.cat: some episodes have charges and some have none")
        return Parameters(
            torch.cat([part.coupling for part in parts]),
            torch.cat([part.mass for part in parts]),
            torch.cat(charges) if charges else None,
            {name: torch.cat([part.scalar(name) for part in parts]) for name in first.scalars},
        )

    def __getitem__(self, index: Any) -> Parameters:
        return self.map(lambda x: x[index])

    def with_coupling(self, value: float | Tensor) -> Parameters:
        """The same bodies under another coupling (the counterfactual of the study)."""
        value = torch.as_tensor(value, dtype=self.coupling.dtype, device=self.coupling.device)
        return replace(self, coupling=value.expand_as(self.coupling))

    def with_scalar(self, name: str, value: float | Tensor) -> Parameters:
        """The same bodies with another strength, or a new one."""
        value = torch.as_tensor(value, dtype=self.coupling.dtype, device=self.coupling.device)
        return replace(self, scalars={**self.scalars, name: value.expand_as(self.coupling)})

    def later(self, seconds: float | Tensor) -> Parameters:
        """The same so many seconds later: the clock has gone on, where there is one."""
        if CLOCK not in self.scalars:
            return self
        return self.with_scalar(CLOCK, self.scalars[CLOCK] + seconds)

    def scalar(self, name: str) -> Tensor:
        """A further strength.

        Raises:
            ValueError: the scene has none of this name.
        """
        if name not in self.scalars:
            known = ", ".join(sorted(self.scalars)) or "none"
            raise ValueError(f"Parameters: no scalar '{name}' (there are: {known})")
        return self.scalars[name]


def kinetic_energy(p: Float[Tensor, "*b n d"], mass: Float[Tensor, "*m n"]) -> Float[Tensor, "*b"]:
    """Sum over bodies of |p|^2 / 2m, shape ``(...)``."""
    return (p.square().sum(-1) / (2 * mass)).sum(-1)
