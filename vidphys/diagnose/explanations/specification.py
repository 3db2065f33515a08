"""What a diagnosed scene requires, as data from which exactly that model is built, no term more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, JsonValue, model_validator

from dynamics import from_config, terms, to_config
from dynamics.terms import HeadTerm, Term
from vidphys.boundary import Above, Closed, Number, Word, read_json
from vidphys.diagnose.explanations.bounds import require_bounded
from vidphys.errors import InputError

SCHEMA_VERSION = 1
MOST_BODIES = 1000


def as_specification(
    term: HeadTerm,
    bodies: int,
    origin: Sequence[float],
    numbers: Mapping[str, tuple[float, float]],
    explained: bool,
    interval: float,
) -> dict[str, Any]:
    """A scene as JSON; see :func:`read_specification`.

    Args:
        term: its model.
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
        "terms": to_config(at_numbers(term, numbers, len(origin))),
        "numbers": {name: _finite(value) for name, value in numbers.items()},
        "explained": explained,
    }


def at_numbers(term: Term, numbers: Mapping[str, tuple[float, float]], space: int) -> Term:
    """The same term, whose fields, frictions and bath start at the numbers that were found.

    Args:
        term: of the scene, or a part of it; a part with a number of its own keeps that.
        numbers: of the menu's terms, by kind and name, each with its standard error.
        space: dimensions d.
    """
    known = {name: value for name, (value, _) in numbers.items() if np.isfinite(value)}
    if isinstance(term, terms.Uniform) and term.acceleration is None:
        found = tuple(known.get(f"uniform: {axis}", 0.0) for axis in "xyz"[:space])
        return replace(term, acceleration=found) if any(found) else term
    if isinstance(term, terms.Drag) and term.rate is None:
        rate = known.get(f"{term.law}: rate")
        usable = rate is not None and (rate > 0 or term.strength == "free")
        return replace(term, rate=rate) if usable else term
    if isinstance(term, terms.ConstantBath) and term.rate is None:
        rate = known.get("linear: rate")
        return replace(term, rate=rate) if rate is not None and rate > 0 else term
    return term.with_parts(lambda part: at_numbers(part, numbers, space))


def _finite(pair: tuple[float, float]) -> dict[str, float | None]:
    value, error = pair
    return {"value": value, "standard_error": error if np.isfinite(error) else None}


class Estimate(Closed):
    """A number of a term; no error where none is known."""

    value: Number | None
    standard_error: Annotated[float, Field(ge=0)] | None


Axis = Annotated[list[Number], Field(min_length=3, max_length=3)]


class Specification(Closed):
    """What ``specification.json`` holds; see :func:`as_specification`.

    Its plane is there where the bodies move in a plane of space: the axes along which the model's
    two coordinates are counted.
    """

    schema_version: Literal[1]
    bodies: Annotated[int, Field(ge=1, le=MOST_BODIES)]
    space: Annotated[int, Field(ge=1, le=3)]
    interval_seconds: Above
    origin: Annotated[list[Number], Field(min_length=1, max_length=3)]
    terms: dict[str, JsonValue]
    numbers: Annotated[dict[Word, Estimate], Field(max_length=1000)]
    explained: bool
    mass: Annotated[list[Above], Field(max_length=MOST_BODIES)] | None = None
    inputs: Annotated[list[Word], Field(max_length=1000)] = []
    plane: Annotated[list[Axis], Field(min_length=1, max_length=2)] | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for name, held, count in (
            ("origin", self.origin, self.space),
            ("mass", self.mass, self.bodies),
        ):
            if held is not None and len(held) != count:
                raise ValueError(f"{name}: has {len(held)} numbers and needs {count}")
        if self.plane is not None and self.space != len(self.plane):
            axes = len(self.plane)
            raise ValueError(
                f"plane: is of a scene in {axes} dimensions, this one has {self.space}"
            )
        return self


def read_specification(path: Path) -> tuple[HeadTerm, Mapping[str, Any]]:
    """The model and the rest of a specification.

    Raises:
        InputError: not a specification, or of another version; the field that is wrong is named.
    """
    import torch

    from dynamics import build

    held = read_json(path, Specification, "a scene specification; `vidphys diagnose` writes one")
    try:
        term = from_config(held.terms)
        if not isinstance(term, HeadTerm):
            raise ValueError("no model of a whole scene")
        require_bounded(term)
        with torch.random.fork_rng(devices=[]):
            build(term, held.bodies, held.interval_seconds, held.space)
    except (TypeError, ValueError, AttributeError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{path}: terms that make no model ({error}); `vidphys diagnose` writes them"
        ) from error
    return term, held.model_dump(exclude_none=True)
