"""Strings from a fixed place, which go slack and catch their weights again."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics.around import Around
from dynamics.findings import Finding, OverlapWarning, counted
from dynamics.hamiltonian import Hamiltonian
from dynamics.integrators import Memory
from dynamics.numbers import number
from dynamics.state import Parameters, PhaseState

HALVINGS = 30  # of a step, in which the moment is sought at which a string is taut
BEYOND = 1e-3  # of its length: a start farther out is told


class Strung(Around):
    """Bodies on strings that do not stretch, push nothing, and catch without a bounce.

    A step that ends beyond a string's end is taken back to where the string became taut, which
    takes the speed along it. From there the weight is kept at the end by a step of RATTLE
    (Andersen 1983, J. Comput. Phys. 52) for as long as the string has to pull.

    Args:
        free: the model without the strings.
        centre: where they hang, ``(d,)``, world units.
        length: of each, world units.
        learned: whether both are.

    Raises:
        ValueError: a length that is not above zero.
    """

    centre: Tensor
    length: Tensor

    def __init__(
        self, free: Hamiltonian, centre: Sequence[float], length: float, learned: bool = True
    ) -> None:
        super().__init__(free)
        if not length > 0:
            raise ValueError(f"Strung: length must be > 0, got {length}")
        number(self, "centre", centre, learned)
        number(self, "length", length, learned)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        later, memory = self.free.advance(state, params, dt, memory)
        beyond = self._beyond(later.q) > 0
        if not bool(beyond.any()):
            return later, memory
        caught = self._caught(state, later, params.mass.unsqueeze(-1), dt)
        beyond = beyond.unsqueeze(-1)
        q, p = torch.where(beyond, caught.q, later.q), torch.where(beyond, caught.p, later.p)
        return PhaseState(q, p), None

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        found = super().concerns(params, start)
        if start is None:
            return found
        out = (self._beyond(start.q) > BEYOND * self.length.to(start.q)).any(-1)
        if bool(out.any()):
            text = f"Strung: bodies start beyond a string's end in {counted(out)}; it takes them in"
            found.append(Finding(OverlapWarning, text, out, 0, term="Strung"))
        return found

    def _beyond(self, q: Float[Tensor, "*b n d"]) -> Float[Tensor, "*b n"]:
        """How far beyond the string's end, world units."""
        return (q - self.centre.to(q)).norm(dim=-1) - self.length.to(q)

    def _caught(self, before: PhaseState, after: PhaseState, mass: Tensor, dt: float) -> PhaseState:
        """At the end of a step, of which ``after`` is what there would be without a string."""
        centre, length = self.centre.to(before.q), self.length.to(before.q)
        start, v = before.q - centre, before.p / mass
        a, moved = (after.p / mass - v) / dt, after.q - before.q
        share = self._taut(start, v * dt, moved - v * dt, length)
        met = start + share * (v * dt + share * (moved - v * dt))
        out = _directed(met)
        v = v + share * dt * a
        v = v - (v * out).sum(-1, keepdim=True).clamp_min(0) * out
        return self._kept(length * out, v, a, (1 - share) * dt, mass)

    def _kept(self, at: Tensor, v: Tensor, a: Tensor, left: Tensor, mass: Tensor) -> PhaseState:
        """After ``left`` seconds more, from the string's end."""
        length, out = self.length.to(at), _directed(at)
        end = at + left * (v + 0.5 * left * a)
        along = (end * out).sum(-1, keepdim=True)
        beside = (end - along * out).square().sum(-1, keepdim=True)
        pulled = (along - (length.square() - beside).clamp_min(0).sqrt()).clamp_min(0)
        end = end - pulled * out
        some = left > 0
        v = v + left * a - torch.where(some, pulled / torch.where(some, left, 1), 0) * out
        out = _directed(end)
        held = pulled > 0
        v = torch.where(held, v - (v * out).sum(-1, keepdim=True) * out, v)
        end = torch.where(held, length * out, end)
        return PhaseState(end + self.centre.to(end), mass * v)

    @staticmethod
    def _taut(start: Tensor, first: Tensor, second: Tensor, length: Tensor) -> Tensor:
        """The share of a step ``(..., n, 1)`` at which ``start + x first + x^2 second`` comes to
        the string's end; 0 where it starts there.
        """

        def beyond(x: Tensor) -> Tensor:
            path = start + x * (first + x * second)
            return path.square().sum(-1, keepdim=True) - length.square()

        with torch.no_grad():
            low = torch.zeros_like(start[..., :1])
            high = torch.ones_like(low)
            # what was kept at the end a step before is there but for rounding
            high = torch.where(beyond(low) > -4 * torch.finfo(low.dtype).eps * length**2, 0, high)
            for _ in range(HALVINGS if bool((high > 0).any()) else 0):
                middle = 0.5 * (low + high)
                past = beyond(middle) >= 0
                low, high = torch.where(past, low, middle), torch.where(past, middle, high)
        # one step of Newton's method more, through which a gradient knows when that was
        path, way = start + high * (first + high * second), first + 2 * high * second
        slope = 2 * (path * way).sum(-1, keepdim=True)
        least = torch.finfo(slope.dtype).eps ** 0.5 * length * way.norm(dim=-1, keepdim=True)
        steep = slope > least
        newton = beyond(high) / torch.where(steep, slope, 1)
        return torch.where(steep & (high > 0), high - newton, high).clamp(0, 1)


def _directed(x: Tensor) -> Tensor:
    """Of length one, where there is a direction."""
    return torch.nn.functional.normalize(x, dim=-1)
