"""The numbers that a fitted model ended with, in the units of its tracks, by name."""

from __future__ import annotations

import torch
from torch import nn

from dynamics.bath import ConstantBath
from dynamics.clocked import Lift, Sinusoid
from dynamics.each import Each, Spring
from dynamics.fields import Centre, EllipticTrap, Pendulum, Tether, UniformField, Well
from dynamics.friction import Friction
from dynamics.links import Hanging
from dynamics.ports import PlacewiseFriction, Turning
from dynamics.potentials import HarmonicTrap
from dynamics.shapes import SHAPES, ShapedPotential
from dynamics.sliding import Along, Rubbed
from dynamics.strings import Strung
from dynamics.terms.potentials import SHAPE_LENGTHS
from vidphys.reading.fitted import Fitted


def numbers_of(fitted: Fitted) -> dict[str, float]:
    """Rates per second, stiffness per second squared, accelerations in units of length.

    Bodies with a law of their own have their number behind the name.
    """
    head, found = fitted.head, {}
    parts = list(head.laws) if isinstance(head, Each) else [head]
    with torch.no_grad():
        for k, law in enumerate(parts, 1):
            behind = f"_{k}" if len(parts) > 1 else ""
            for part in law.modules():
                for name, value in _numbers(part, fitted).items():
                    found[f"{name}{behind}"] = value
        for part in head.modules():
            if isinstance(part, Spring):
                name = f"spring_{part.first + 1}_{part.second + 1}"
                found[name] = float(part.stiffness) / fitted.units.seconds**2
    if "temperature" in fitted.params.scalars:
        size = (fitted.units.length / fitted.units.seconds) ** 2
        found["temperature"] = float(fitted.params.scalars["temperature"][0]) * size
    return found


def _numbers(part: nn.Module, fitted: Fitted) -> dict[str, float]:
    length, seconds = fitted.units.length, fitted.units.seconds
    if isinstance(part, Pendulum):
        return {"pendulum_rate2": float(part.rate2) / seconds**2}
    if isinstance(part, Hanging):
        return {"gravity": float(part.gravity) / seconds**2}
    if isinstance(part, Well):
        return {"well_stiffness": float(part.stiffness) / seconds**2}
    if isinstance(part, HarmonicTrap):
        return {"trap_stiffness": float(part.stiffness) / seconds**2}
    if isinstance(part, EllipticTrap):
        each = torch.linalg.eigvalsh(part.stiffness) / seconds**2
        return {f"trap_stiffness_across_{k}": x for k, x in enumerate(each.tolist(), 1)}
    if isinstance(part, Tether):
        rest = float(part.rest) * length
        return {"tether_stiffness": float(part.stiffness) / seconds**2, "tether_rest": rest}
    if isinstance(part, Centre):
        strength = float(part.strength) * length / seconds**2
        return {"centre_strength": strength, "centre_power": float(part.power)}
    if isinstance(part, ShapedPotential):
        return _of_pairs(part, length, seconds)
    if isinstance(part, Strung):
        return {"string_length": float(part.length) * length}
    if isinstance(part, Rubbed):
        return {"friction_coefficient": float(part.coefficient)}
    if isinstance(part, Turning):
        names = ["turning"] if len(part.rate) == 1 else [f"turning_{axis}" for axis in "xyz"]
        return dict(zip(names, (part.rate / seconds).tolist(), strict=True))
    if isinstance(part, Lift):
        return {"lift": float(part.rate) / seconds}
    if isinstance(part, Sinusoid):
        size = float(torch.hypot(part.along, part.across).norm()) * length / seconds**2
        return {"forcing": size, "forcing_rate": float(part.rate) / seconds}
    if isinstance(part, PlacewiseFriction):
        rates = (x / (seconds * length**k) for k, x in enumerate(part.rates.tolist()))
        return dict(zip(("friction", "friction_x", "friction_x2"), rates, strict=True))
    if isinstance(part, UniformField | Along):
        pull = (part.acceleration * length / seconds**2).tolist()
        return {f"uniform_{axis}": x for axis, x in zip("xyz", pull, strict=False)}
    if isinstance(part, ConstantBath):
        return {"friction_bath": float(nn.functional.softplus(part.raw)) / seconds}
    if isinstance(part, Friction):
        unit = {"linear": 1 / seconds, "square": 1 / length, "dry": length / seconds**2}[part.law]
        return {f"friction_{part.law}": float(part.coefficient(fitted.params)) * unit}
    return {}


def _of_pairs(part: ShapedPotential, length: float, seconds: float) -> dict[str, float]:
    name, power = f"pair_{part.shape.replace('-', '_')}", SHAPE_LENGTHS[part.shape]
    found = {f"{name}_strength": float(part.strength) * length**power / seconds**2}
    sized = SHAPES[part.shape].sized
    return found | ({f"{name}_length": float(part.length) * length} if sized else {})
