"""The numbers of terms of the menu: with what unit each goes, and how they are told."""

from __future__ import annotations

from itertools import groupby

from dynamics.terms.potentials import SHAPE_LENGTHS
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import FRICTION, PAIR, Term
from vidphys.diagnose.mechanisms.quantities import Quantity
from vidphys.diagnose.recordings.units import Units
from vidphys.statistics import NORMAL_95, with_error

POWERS = {  # of length and of seconds, by kind, or by kind and name where they differ
    "uniform": (1, -2),
    "trap": (1, -2),
    "trap: stiffness": (0, -2),
    "well: stiffness": (0, -2),
    "well: push": (1, -2),
    "well: second": (-1, -2),
    "well: third": (-2, -2),
    "pendulum": (0, -2),
    "linear": (0, -1),
    "square": (-1, 0),
    "dry": (1, -2),
}


def quantities_of(inference: Inference) -> list[Quantity]:
    """Those of the terms, by kind and name; a temperature's error is not known."""
    fitted = inference.fitted
    found = []
    for term in inference.terms:
        at = fitted.place(term)
        for k, name in enumerate(term.named):
            value, error = float(fitted.values[at + k]), float(fitted.errors[at + k])
            found.append(Quantity(name, value, error, *_powers(term, k)))
        if term.scale is not None:
            value, error = float(fitted.values[-1]), float(fitted.errors[-1])
            found.append(Quantity(f"{term.kind}: length", value, error, 1))
    if inference.bathed:
        found.append(Quantity("bath: temperature", temperature(inference), float("nan"), 2, -2))
    return found


def _powers(term: Term, k: int) -> tuple[int, int]:
    """Of length and seconds, that go with a term's coefficient."""
    if term.family == PAIR:
        return SHAPE_LENGTHS[term.shapes[k]], -2
    name = term.named[k]
    return POWERS.get(name) or POWERS[name.partition(":")[0]]


def temperature(inference: Inference) -> float:
    """Temperature at which the kicks balance the friction (k_B = 1), of unit masses."""
    friction = inference.structure.term(FRICTION)
    rate = 0.0 if friction is None else float(inference.structure.of(friction)[0])
    return inference.kicks / (2 * rate) if rate > 0 else float("inf")


def number_lines(inference: Inference, units: Units) -> list[str]:
    """A line of each kind of term, with its numbers, their 95 % intervals and units."""
    lines = []
    for kind, numbers in groupby(quantities_of(inference), lambda x: x.name.partition(": ")[0]):
        if kind == "bath":
            (bath,) = numbers
            value, unit = units.told(bath.value, bath.length), units.named(2, -2)
            lines.append(f"bath: temperature {value:.3g} {unit} (unit masses, k_B = 1)")
            continue
        said = (told_of(x, units) for x in numbers)
        lines.append(f"{kind}: {', '.join(said)} (95 %)")
    return lines


def told_of(x: Quantity, units: Units) -> str:
    """A number by its name without its kind, with its 95 % interval and unit."""
    value, error = (units.told(v, x.length) for v in (x.value, NORMAL_95 * x.error))
    unit = units.named(x.length, x.seconds)
    return f"{x.name.partition(': ')[2]} {with_error(value, error)} {unit}".rstrip()
