"""The model that terms of the menu stand for, at the numbers that were found."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics import terms
from dynamics.terms import PortTerm, PotentialTerm
from vidphys.diagnose.explanations.menu_numbers import quantities_of
from vidphys.diagnose.explanations.specification import as_specification
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import EXTERNAL, PAIR, Term

PORTS: dict[str, PortTerm] = {
    "linear": terms.Drag("linear", "positive"),
    "square": terms.Drag("square", "positive"),
    "dry": terms.Drag("dry", "positive"),
    "drive": terms.Drag("linear", "free"),
}
BATH = terms.ConstantBath()


def specification(inference: Inference, interval: float) -> dict[str, Any]:
    """The scene as JSON: terms, what is known of their numbers, and where the origin lies.

    Args:
        inference: what was found.
        interval: seconds between frames.
    """
    _, origin = _outside(inference)
    return as_specification(
        model_of(inference),
        inference.windows.frames.shape[2],
        origin or [0.0] * inference.windows.frames.shape[-1],
        {x.name: (x.value, x.error) for x in quantities_of(inference)},
        inference.leftover.explained,
        interval,
    )


def model_of(inference: Inference) -> terms.Hamiltonian:
    """The model that has the terms that were found, and no other."""
    kinds = inference.kinds
    outside, _ = _outside(inference)
    potentials = [*_between(inference), *([] if outside is None else [outside])]
    ports = [PORTS[kind] for kind in sorted(kinds) if kind in PORTS]
    if "bath" in kinds:
        # The bath brings its own friction: fluctuation and dissipation are one term.
        ports = [BATH]
    return terms.Hamiltonian(
        potentials=tuple(potentials) or (terms.NoPotential(),), ports=tuple(ports)
    )


def _between(inference: Inference) -> list[PotentialTerm]:
    """What acts between pairs: of the shape that was found, unless that leaves more than noise."""
    term = inference.structure.term(PAIR)
    if term is None:
        return []
    if not inference.leftover.explained:
        ends = term.scale if term.kind == "contact" else None
        return [terms.Radial() if ends is None else terms.Knots(reach=ends)]
    return shaped(term, inference.structure.of(term))


def shaped(term: Term, strengths: np.ndarray) -> list[PotentialTerm]:
    """The potentials of a pair force of the menu, one for each of its strengths."""
    parts = term.parts or (term,) * len(strengths)
    return [
        terms.Shaped(
            part.source, shape=shape, strength=float(strength), length=float(part.scale or 1.0)
        )
        for part, shape, strength in zip(parts, term.shapes, strengths, strict=True)
    ]


def _outside(inference: Inference) -> tuple[PotentialTerm | None, list[float]]:
    """A force from outside, and the model's origin where it is that force's centre."""
    term = inference.structure.term(EXTERNAL)
    if term is None:
        return None, []
    first, *others = (float(x) for x in inference.structure.of(term))
    if term.kind == "trap":
        return terms.Trap(first, learned=True), [pull / first for pull in others]
    if term.kind == "well":
        push, second, third = others
        return terms.Well(first, push, second, third), []
    if term.kind == "pendulum":
        aside = others[0]
        return terms.Pendulum(float(np.hypot(first, aside))), [float(np.arctan2(aside, first))]
    return terms.Uniform(), []
