"""What a diagnosed scene requires, as data from which exactly that model is built, no term more."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dynamics.terms import HamiltonianTerms, from_config, to_config
from vidphys.errors import InputError

SCHEMA_VERSION = 1
PORTS = {
    "linear": "linear-drag-positive",
    "square": "square-drag-positive",
    "dry": "dry-drag-positive",
    "drive": "linear-drag-free",
}
BATH = "constant-bath"


def terms_of(
    kinds: frozenset[str], trap: float | None = None, reach: float = 1.0
) -> HamiltonianTerms:
    """The terms of a model that has these kinds.

    Args:
        kinds: see :attr:`vidphys.diagnose.inference.inference.Inference.kinds`.
        trap: stiffness of the trap, where there is one.
        reach: of a contact, world units.
    """
    potential: Literal["radial", "knots", "free", "none"] = "none"
    if "pair" in kinds:
        potential = "radial"
    elif "contact" in kinds:
        potential = "knots"
    elif kinds & {"pendulum", "well"}:
        potential = "free"
    ports = [PORTS[kind] for kind in sorted(kinds) if kind in PORTS]
    if "bath" in kinds:
        # The bath brings its own friction: fluctuation and dissipation are one term.
        ports = [BATH]
    return HamiltonianTerms(
        potential=potential,
        trap=trap if "trap" in kinds else None,
        reach=reach,
        uniform="uniform" in kinds,
        ports=tuple(ports),
    )


def as_specification(
    terms: HamiltonianTerms,
    bodies: int,
    origin: Sequence[float],
    numbers: Mapping[str, tuple[float, float]],
    explained: bool,
    interval: float,
) -> dict[str, Any]:
    """A scene as JSON; see :func:`read_specification`.

    Args:
        terms: that it has.
        bodies: N.
        origin: of the model's coordinates in those of the tracks, ``(d,)``.
        numbers: what is known of the terms, each with its standard error, which may be infinite.
        explained: whether the terms leave no more than noise.
        interval: seconds between frames.
    """
    return {
        "schema_version": SCHEMA_VERSION,
        "bodies": bodies,
        "space": len(origin),
        "interval_seconds": interval,
        "origin": list(origin),
        "terms": to_config(terms),
        "numbers": {name: _finite(value) for name, value in numbers.items()},
        "explained": explained,
    }


def _finite(pair: tuple[float, float]) -> dict[str, float | None]:
    value, error = pair
    return {"value": value, "standard_error": error if np.isfinite(error) else None}


def read_specification(path: Path) -> tuple[HamiltonianTerms, Mapping[str, Any]]:
    """Terms and the rest of a specification.

    Raises:
        InputError: not a specification, or of another version.
    """
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        terms = from_config(held["terms"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: not a scene specification ({error}); `vidphys diagnose` writes one"
        ) from error
    if held.get("schema_version") != SCHEMA_VERSION or not isinstance(terms, HamiltonianTerms):
        raise InputError(
            f"{path}: version {held.get('schema_version')} of a scene specification, this program "
            f"reads {SCHEMA_VERSION}; run `vidphys diagnose` again"
        )
    return terms, held
