"""Bodies that each follow a law of their own, and springs and contacts between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.bound import Bound
from dynamics.collide import Contact
from dynamics.findings import Finding
from dynamics.head import Head, Trajectory, stepped
from dynamics.integrators import Memory
from dynamics.numbers import number
from dynamics.state import Parameters, PhaseState


class Spring(nn.Module):
    """V = stiffness (x - rest)^2 / 2 with x = s_i - s_j of two coordinates.

    Between the ends of two pendulums x is by how much these are farther apart than their pivots.

    Args:
        first, second: indices i and j of the bodies.
        stiffness: per second squared, of unit masses.
        rest: x where it does not pull.
        apart: along a level line, from the first pendulum's pivot to the second one's, over their
            length; 0: it joins the coordinates, whatever they are.
        learned: whether stiffness and rest are.
    """

    stiffness: Tensor
    rest: Tensor

    def __init__(
        self,
        first: int,
        second: int,
        stiffness: float,
        rest: float = 0.0,
        apart: float = 0.0,
        learned: bool = True,
    ) -> None:
        super().__init__()
        self.first, self.second, self.apart = first, second, apart
        number(self, "stiffness", stiffness, learned)
        number(self, "rest", rest, learned)

    def energy(self, s: Float[Tensor, "*b n 1"]) -> Float[Tensor, "*b"]:
        """V of each state."""
        stretch, _ = self._stretched(s)
        return 0.5 * self.stiffness.to(s) * stretch.square()

    def force(self, s: Float[Tensor, "*b n 1"]) -> Float[Tensor, "*b n 1"]:
        """-dV/ds."""
        stretch, slopes = self._stretched(s)
        out = torch.zeros_like(s)
        for body, slope in zip((self.first, self.second), slopes, strict=True):
            out[..., body, 0] = -self.stiffness.to(s) * stretch * slope
        return out

    def _stretched(self, s: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """X - rest, and its slopes along the two coordinates."""
        one, two = s[..., self.first, 0], s[..., self.second, 0]
        rest = self.rest.to(s).squeeze()
        if not self.apart:
            return one - two - rest, (torch.ones_like(one), -torch.ones_like(two))
        across, up = self.apart + two.sin() - one.sin(), one.cos() - two.cos()
        far = torch.hypot(across, up)
        first = -(across * one.cos() + up * one.sin()) / far
        second = (across * two.cos() + up * two.sin()) / far
        return far - abs(self.apart) - rest, (first, second)


class Each(Head):
    """One law for each body, and springs and contacts between them where there are any.

    A spring acts on its two bodies along their curves, or in a space of one dimension. Half of
    its kick comes before a step and half after. What collides in a step is taken back to where it
    touched.

    Args:
        laws: of one body each.
        springs: between them.
        contacts: of bodies that may collide, in their coordinates.
    """

    def __init__(
        self,
        laws: Sequence[Head],
        springs: Sequence[Spring] = (),
        contacts: Sequence[Contact] = (),
    ) -> None:
        super().__init__()
        self.laws, self.springs = nn.ModuleList(laws), nn.ModuleList(springs)
        self.contacts = nn.ModuleList(contacts)

    def trajectory(
        self, start: PhaseState, params: Parameters, steps: int, dt: float, every: int = 1
    ) -> Trajectory:
        if not self.springs and not self.contacts:
            found = [
                law.trajectory(start[..., [i], :], _of(params, i), steps, dt, every).states
                for i, law in self._all()
            ]
            return Trajectory(_joined(found))
        within = stepped(self._within, self._inward(start, params), params, steps, dt, every)
        return Trajectory(self._outward(within, params.mass.unsqueeze(-2)))

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        later, memory = self._within(self._inward(state, params), params, dt, memory)
        return self._outward(later, params.mass), memory

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        """Of all laws and springs."""
        whole = torch.stack(
            [law.energy(state[..., [i], :], _of(params, i)) for i, law in self._all()]  # type: ignore[operator]
        ).sum(0)
        if self.springs:
            s = self._inward(state, params).q
            whole = whole + torch.stack([spring.energy(s) for spring in self._pulling()]).sum(0)
        return whole

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        own = [law.force(state[..., [i], :], _of(params, i)) for i, law in self._all()]
        whole = torch.cat(own, -2)
        if not self.springs:
            return whole
        s = self._inward(state, params).q
        pull = torch.stack([spring.force(s) for spring in self._pulling()]).sum(0)
        parts = [
            law.curve.pull(s[..., [i], :], pull[..., [i], :])
            if isinstance(law, Bound)
            else pull[..., [i], :]
            for i, law in self._all()
        ]
        return whole + torch.cat(parts, -2)

    def check(self, params: Parameters) -> None:
        for i, law in self._all():
            law.check(_of(params, i))

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        found: list[Finding] = []
        for i, law in self._all():
            one = None if start is None else start[..., [i], :]
            said = law.concerns(_of(params, i), one)
            found += [replace(each, body=i) for each in said]
        return found

    def set_scale(self, q: float, p: float) -> None:
        for _, law in self._all():
            law.set_scale(q, p)

    @property
    def conserves(self) -> bool:
        elastic = all(contact.elastic for contact in self._touching())
        return elastic and all(law.conserves for _, law in self._all())

    @property
    def depends_on(self) -> tuple[str, ...]:
        return tuple({name: None for _, law in self._all() for name in law.depends_on})

    def _all(self) -> list[tuple[int, Head]]:
        return [(i, cast(Head, law)) for i, law in enumerate(self.laws)]

    def _pulling(self) -> list[Spring]:
        return [cast(Spring, spring) for spring in self.springs]

    def _touching(self) -> list[Contact]:
        return [cast(Contact, contact) for contact in self.contacts]

    def _within(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory
    ) -> tuple[PhaseState, Memory]:
        """A step in the coordinates of each law, which remembers the seconds since the start."""
        gone = memory or 0.0
        params, state = params.later(gone), self._kicked(state, dt / 2)
        later = []
        for i, law in self._all():
            inner = law.law if isinstance(law, Bound) else law
            later.append(inner.advance(state[..., [i], :], _of(params, i), dt)[0])
        state = self._kicked(_joined(later), dt / 2)
        for contact in self._touching():
            state = contact.collided(state, params.mass, dt)
        return state, gone + dt

    def _kicked(self, state: PhaseState, dt: float) -> PhaseState:
        for spring in self._pulling():
            state = PhaseState(state.q, state.p + dt * spring.force(state.q))
        return state

    def _inward(self, state: PhaseState, params: Parameters) -> PhaseState:
        return _joined(
            [
                law.inward(state[..., [i], :], _of(params, i))
                if isinstance(law, Bound)
                else state[..., [i], :]
                for i, law in self._all()
            ]
        )

    def _outward(self, state: PhaseState, mass: Tensor) -> PhaseState:
        return _joined(
            [
                law.outward(state[..., [i], :], mass[..., [i]])
                if isinstance(law, Bound)
                else state[..., [i], :]
                for i, law in self._all()
            ]
        )


def _joined(states: Sequence[PhaseState]) -> PhaseState:
    return PhaseState(torch.cat([s.q for s in states], -2), torch.cat([s.p for s in states], -2))


def _of(params: Parameters, body: int) -> Parameters:
    """What the law is told of one body."""
    charge = None if params.charge is None else params.charge[..., [body]]
    return replace(params, mass=params.mass[..., [body]], charge=charge)
