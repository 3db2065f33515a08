"""What if the law were different: factors on a model's numbers, by what they mean."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from dynamics import Head, Parameters
from dynamics.bath import ConstantBath
from dynamics.clocked import Lift, Sinusoid
from dynamics.collide import Contact
from dynamics.couplings import PairLaw
from dynamics.curves import Arc, Chain
from dynamics.each import Spring
from dynamics.fields import Centre, EllipticTrap, Pendulum, Tether, UniformField, Well
from dynamics.friction import Friction
from dynamics.links import Hanging, LinkMetric
from dynamics.numbers import unbent
from dynamics.ports import LinearFriction, PlacewiseFriction, Turning
from dynamics.potentials import HarmonicTrap
from dynamics.sliding import Along, Rubbed
from dynamics.state import CLOCK
from dynamics.strings import Strung
from dynamics.walls import Wall
from vidphys.errors import InputError

MASS, PAIR = "mass", "pair"
# A negative factor on these has a meaning.
SIGNED = ("gravity", "stiffness", "centre", "turning", "lift", "forcing", PAIR, "electric", "drive")


def _times(*names: str, power: int = 1) -> Callable[[Any, float], None]:
    """Multiplies attributes, which are numbers or tensors, by a power of the factor."""

    def change(part: Any, factor: float) -> None:
        for name in names:
            value = getattr(part, name)
            if isinstance(value, Tensor):
                value.mul_(factor**power)
            else:
                setattr(part, name, value * factor**power)

    return change


def _bounce(hit: Any, factor: float) -> None:
    if not 0 <= float(hit.restitution) * factor <= 1:
        raise InputError(
            f"`law` restitution={factor:g}: what is hit keeps {float(hit.restitution):.3g} of the "
            "speed; with so much more it would give energy"
        )
    hit.restitution *= factor


def _slowed(port: Any, factor: float) -> None:
    port.raw.copy_(unbent(float(port.rate) * factor))


def _resisted(port: Any, factor: float) -> None:
    if port.strength == "known":
        return
    positive = port.strength != "free"
    port.set(float(nn.functional.softplus(port.raw) if positive else port.raw) * factor)


def _bathed(bath: Any, factor: float) -> None:
    bath.set(float(nn.functional.softplus(bath.raw)) * factor)


def _longer(metric: Any, factor: float) -> None:
    metric.lengths.mul_(factor)
    metric.inertia.mul_(factor**2)


Change = Callable[[Any, float], None]
# What can be asked, and what it does to each kind of part that has such a number.
QUANTITIES: dict[str, dict[type[nn.Module], Change]] = {
    "friction": {
        Friction: _resisted,
        LinearFriction: _slowed,
        PlacewiseFriction: _times("rates"),
        ConstantBath: _bathed,
        Rubbed: _times("coefficient"),
    },
    "gravity": {
        UniformField: _times("acceleration"),
        Along: _times("acceleration"),
        Pendulum: _times("rate2"),
        Hanging: _times("gravity"),
    },
    "length": {
        Pendulum: _times("rate2", power=-1),
        LinkMetric: _longer,
        Strung: _times("length"),
        Tether: _times("rest"),
    },
    "stiffness": {
        HarmonicTrap: _times("stiffness"),
        EllipticTrap: _times("rows"),
        Tether: _times("stiffness"),
        Spring: _times("stiffness"),
        Well: _times("coefficients"),
    },
    "centre": {Centre: _times("strength")},
    "turning": {Turning: _times("rate")},
    "lift": {Lift: _times("rate")},
    "forcing": {Sinusoid: _times("along", "across")},
    "restitution": {Wall: _bounce, Contact: _bounce},
}
SHAPED: dict[type[nn.Module], Change] = {Arc: _times("frame"), Chain: _times("lengths")}


@dataclass(frozen=True)
class Law:
    """A model, and what it is told."""

    head: Head
    params: Parameters

    @property
    def quantities(self) -> list[str]:
        """What can be asked of it."""
        parts = list(self.head.modules())
        found = [
            name
            for name, kinds in QUANTITIES.items()
            if any(isinstance(part, tuple(kinds)) for part in parts)
        ]
        bodies = self.params.mass.shape[-1]
        masses = [f"{MASS}{k + 1}" for k in range(bodies)] if bodies > 1 else []
        pair = [PAIR] if any(isinstance(vars(x).get("law"), PairLaw) for x in parts) else []
        told = [name for name in self.params.scalars if name != CLOCK]
        return [*dict.fromkeys([*found, *pair, MASS, *masses, *told])]

    def changed(self, factors: Mapping[str, float]) -> Law:
        """The same with some of its quantities multiplied.

        Args:
            factors: by name.

        Raises:
            InputError: it has no such quantity, or one cannot be so large.
        """
        known = self.quantities
        for name in factors:
            if name not in known:
                raise InputError(
                    f"`law` {name}: this model has no such number; it has {', '.join(known)}"
                )
        head, params = copy.deepcopy(self.head), self.params
        with torch.no_grad():
            for name, factor in factors.items():
                if name.startswith(MASS):
                    params = _heavier(head, params, name, factor)
                elif name in params.scalars:  # told, not learned
                    params = params.with_scalar(name, params.scalars[name] * factor)
                elif name == PAIR:
                    params = params.with_coupling(params.coupling * factor)
                else:
                    _change(head, name, factor)
        return Law(head, params)


def _change(head: nn.Module, name: str, factor: float) -> None:
    kinds = QUANTITIES[name] | (SHAPED if name == "length" else {})
    inside = {id(part.arc) for part in head.modules() if isinstance(part, Chain)}
    for part in head.modules():
        if type(part) in kinds and id(part) not in inside:
            kinds[type(part)](part, factor)


def _heavier(head: nn.Module, params: Parameters, name: str, factor: float) -> Parameters:
    """Of one body, ``mass2``, or of all, ``mass``; rods have masses of their own."""
    which = (
        slice(None) if name == MASS else slice(int(name[len(MASS) :]) - 1, int(name[len(MASS) :]))
    )
    rods = [part for part in head.modules() if isinstance(part, LinkMetric)]
    for rod in rods:
        rod.masses[which] *= factor
        rod.inertia[which] *= factor
    if rods:
        return params
    mass = params.mass.clone()
    mass[..., which] *= factor
    return Parameters(params.coupling, mass, params.charge, params.scalars)


def factors_of(texts: tuple[str, ...]) -> dict[str, float]:
    """What was asked, as ``friction=0`` or ``length=0.5``.

    Raises:
        InputError: not NAME=FACTOR.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError as error:
            raise InputError(
                f"`law` {text}: write NAME=FACTOR, for example friction=0 or length=0.5"
            ) from error
        if not 0 <= found[name] < float("inf") and name not in SIGNED:
            raise InputError(f"`law` {text}: a factor on {name} must be zero or above")
        if name in ("length",) + (MASS,) and found[name] == 0:
            raise InputError(f"`law` {text}: no {name} at all means nothing; use a factor above 0")
    return found
