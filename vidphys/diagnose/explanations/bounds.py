"""What the numbers of a term may be, where somebody else wrote them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from dynamics.terms import TERMS, Term
from vidphys.boundary import LARGEST, said

MOST_PARTS = 256
MOST_NUMBERS = 4096  # in a row, of a curve's points
WIDEST = 4096  # of a network, and of anything else that is counted
POSITIVE = {  # by term; numbers that are a size or a strength
    "trap": {"stiffness"},
    "pendulum": {"length"},
    "knots": {"reach"},
    "links": {"lengths", "masses"},
    "on-chain": {"lengths"},
    "contact": {"reach"},
    "centre": {"near"},
    "shaped": {"length"},
    "strung": {"length"},
    "hamiltonian": {"box"},
    "hard-disks": {"box"},
}
MOST_BOUNCE = 2.0  # restitution; a trampoline gives back more than it gets
EXACT = ConfigDict(arbitrary_types_allowed=True, strict=True)


def require_bounded(term: Term) -> None:
    """Refuse a term, or one in it, whose fields are of another type or out of all bounds.

    Raises:
        ValueError: which field, and why.
    """
    for count, part in enumerate(_parts(term), 1):
        if count > MOST_PARTS:
            raise ValueError(f"more than {MOST_PARTS} terms")
        name, hints = TERMS.name_of(type(part)), get_type_hints(type(part))
        for field in fields(part):
            value = getattr(part, field.name)
            try:
                TypeAdapter(hints[field.name], config=_config(hints[field.name])).validate_python(
                    value, strict=True
                )
            except ValidationError as error:
                raise ValueError(f"{name}: {said(error, field.name)}") from error
            for number in _numbers(value):
                told = f"{name}: {field.name} {number}"
                _require(told, number, name, field.name)
                if hints[field.name] is int and not 0 <= number <= WIDEST:
                    raise ValueError(f"{told}: must be from 0 to {WIDEST}")


def _config(hint: Any) -> ConfigDict | None:
    """Pydantic takes none beside a type that brings its own."""
    return None if hasattr(hint, "__dataclass_fields__") else EXACT


def _parts(value: Any) -> Iterator[Term]:
    if isinstance(value, Term):
        yield value
        for field in fields(value):  # type: ignore[arg-type]
            yield from _parts(getattr(value, field.name))
    elif isinstance(value, tuple):
        for each in value:
            yield from _parts(each)


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        if len(value) > MOST_NUMBERS:
            raise ValueError(f"{len(value)} numbers in a row, more than {MOST_NUMBERS}")
        for each in value:
            yield from _numbers(each)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


def _require(told: str, number: float, term: str, field: str) -> None:
    if not math.isfinite(number) or abs(number) > LARGEST:
        raise ValueError(f"{told}: must be a number within {LARGEST:g}")
    if field in POSITIVE.get(term, ()) and not number > 0:
        raise ValueError(f"{told}: must be above 0")
    if field == "restitution" and not 0 <= number <= MOST_BOUNCE:
        raise ValueError(f"{told}: must be from 0 to {MOST_BOUNCE:g}")
