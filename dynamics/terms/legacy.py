"""Configurations as run folders held them before parts had names: a flat table for each model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from registry import unknown

# What a Hamiltonian's table held where nothing else was said.
FLAT: dict[str, Any] = {
    "kinetic": "fixed",
    "potential": "displacement",
    "sources": ("mass",),
    "coupling": "linear",
    "box": None,
    "reach": 1.0,
    "shortcut": False,
    "trap": None,
    "uniform": False,
    "wall": (),
    "width": 64,
    "activation": "tanh",
    "integrator": "leapfrog",
    "ports": (),
    "triples": False,
}
KINETIC = {"body": "per-body", "free": "free-kinetic"}
WHOLE = {"free": "free-potential", "none": "no-potential"}
FORMALISM = {"hamiltonian": "generalised-hamiltonian"}


def nested(config: Mapping[str, Any]) -> dict[str, Any]:
    """The same with a name for each part; ``kind`` says which model it is of.

    Raises:
        ValueError: a Hamiltonian's key that there never was.
    """
    held = {key: value for key, value in config.items() if key != "kind"}
    if config["kind"] == "hamiltonian":
        for key in held:
            if key not in FLAT:
                raise unknown("field of 'hamiltonian'", key, FLAT)
        return _hamiltonian({**FLAT, **held})
    if config["kind"] == "generalised":
        formalism = held.pop("formalism", "hamiltonian")
        held["ports"] = [_port(name) for name in held.get("ports", ())]
        return {"term": FORMALISM.get(formalism, formalism), **held}
    return {"term": config["kind"], **held}


def _hamiltonian(flat: Mapping[str, Any]) -> dict[str, Any]:
    network = {"width": flat["width"], "activation": flat["activation"]}
    kinetic = KINETIC.get(flat["kinetic"], flat["kinetic"])
    potentials = list(_potentials(flat, network))
    if flat["shortcut"]:
        potentials = [{"term": "shortcut", "beside": potentials, "width": flat["width"]}]
    free = {
        "term": "hamiltonian",
        "kinetic": {"term": kinetic, **({} if kinetic == "fixed" else network)},
        "potentials": potentials,
        "ports": [_port(name) for name in flat["ports"]],
        "integrator": flat["integrator"],
        "box": flat["box"],
    }
    if not flat["wall"]:
        return free
    place, restitution, *normal = flat["wall"]
    wall = {"place": place, "restitution": restitution, "normal": normal}
    return {"term": "walled", "free": free, **wall}


def _potentials(flat: Mapping[str, Any], network: Mapping[str, Any]) -> list[dict[str, Any]]:
    name, coupling = flat["potential"], flat["coupling"]
    found: list[dict[str, Any]]
    if name in ("linear", "localised", "gain"):
        found = [{"term": "mapped", "features": name, **network}]
    elif name in WHOLE:
        found = [{"term": WHOLE[name], **(network if name == "free" else {})}]
    else:
        own = {"knots": flat["width"], "reach": flat["reach"]} if name == "knots" else network
        law = {"term": name, "coupling": coupling, **own}
        found = [{**law, "source": source} for source in flat["sources"]]
    if flat["triples"]:
        found.append({"term": "triple", "coupling": coupling, **network})
    if flat["uniform"]:
        found.append({"term": "uniform"})
    if flat["trap"] is not None:
        found.append({"term": "trap", "stiffness": flat["trap"]})
    return found


def _port(name: str) -> dict[str, Any]:
    law, drag, strength = name.partition("-drag-")
    return {"term": "drag", "law": law, "strength": strength} if drag else {"term": name}
