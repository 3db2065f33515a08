"""How the strength of a pair law enters the force, and which property of the bodies it acts on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics.powers import COUPLINGS
from dynamics.state import Parameters


def _mass(params: Parameters) -> tuple[Tensor, Tensor]:
    return params.coupling, params.mass


def _charge(params: Parameters) -> tuple[Tensor, Tensor]:
    if params.charge is None:
        raise ValueError("a pair law of charges needs parameters with charges; these have none")
    return -params.scalar("electric"), params.charge


def _alike(params: Parameters) -> tuple[Tensor, Tensor]:
    return params.coupling, torch.ones_like(params.mass)


# name -> (strength (...), property of each body (..., n)); like charges repel, hence the sign
SOURCES: dict[str, Callable[[Parameters], tuple[Tensor, Tensor]]] = {
    "mass": _mass,
    "charge": _charge,
    "alike": _alike,
}


@dataclass(frozen=True)
class PairLaw:
    """V = c(G) sum_{i<j} s_i s_j phi(q_i - q_j), all but phi.

    Args:
        source: what s is: ``mass`` (with G), ``charge`` (with the scalar ``electric``, like
            charges repelling an attractive phi) or ``alike`` (1 for every body, with G).
        coupling: the function c: ``linear``, ``even`` (the size of G), ``quadratic`` (G squared) or
            ``cubic``.
        box: side of a periodic box in world units, over which displacements are wrapped to the
            nearest image; ``None`` for open space.

    Raises:
        ValueError: an unknown source or coupling, or a box without size.

    Example:
        >>> PairLaw(box=4.0).nearest(torch.tensor([3.0, -3.0, 1.0])).tolist()  # world units
        [-1.0, 1.0, 1.0]
        >>> law = Parameters(torch.tensor([-2.0]), torch.ones(1, 3))
        >>> PairLaw(coupling="quadratic").strength(law)[0]
        tensor([4.])
    """

    source: str = "mass"
    coupling: str = "linear"
    box: float | None = None

    def __post_init__(self) -> None:
        for what, known, name in (
            ("source", SOURCES, self.source),
            ("coupling", COUPLINGS, self.coupling),
        ):
            if name not in known:
                raise ValueError(f"PairLaw: unknown {what} '{name}'; known: {', '.join(known)}")
        if self.box is not None and not self.box > 0:
            raise ValueError(f"PairLaw: box must be > 0, got {self.box}")

    def strength(self, params: Parameters) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b n"]]:
        """c(G) of each episode ``(...)`` and s of each body ``(..., n)``."""
        strength, amount = SOURCES[self.source](params)
        return COUPLINGS[self.coupling](strength), amount

    def nearest(self, displacement: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """The displacement to the nearest image; itself in open space."""
        if self.box is None:
            return displacement
        return displacement - self.box * torch.round(displacement / self.box)
