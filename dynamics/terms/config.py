"""Terms as nested data with a name for each part, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from dynamics.terms import legacy
from dynamics.terms.term import TERMS, Term
from registry import unknown


def to_config(term: Term) -> dict[str, Any]:
    """A term as JSON would hold it, each part under its name in :data:`TERMS`.

    Raises:
        TypeError: a term holds what JSON does not.

    Example:
        >>> from dynamics import terms
        >>> spring = terms.Hamiltonian(potentials=(terms.Trap(2.0),))
        >>> held = terms.to_config(spring)
        >>> held["potentials"]
        [{'term': 'trap', 'stiffness': 2.0, 'centre': None, 'learned': False}]
        >>> terms.from_config(held) == spring
        True
    """
    held = {field.name: _data(getattr(term, field.name)) for field in fields(term)}
    return {"term": TERMS.name_of(type(term)), **held}


def from_config(config: Mapping[str, Any]) -> Any:
    """Inverse of :func:`to_config`; also of what older versions wrote.

    Raises:
        ValueError: an unknown name or field (the nearest spelling is given), or one that is missing
            or of the wrong kind.

    Example:
        >>> from dynamics import terms
        >>> terms.from_config({"term": "residual", "widht": 32})
        Traceback (most recent call last):
        registry.registry.UnknownName: unknown field of 'residual' 'widht'; did you mean 'width'? \
Known: width, angles
    """
    if "kind" in config:
        config = legacy.nested(config)
    if "term" not in config:
        raise ValueError(f"from_config: a term's configuration names its 'term', got {config}")
    name = config["term"]
    kind = TERMS[name]
    if not (isinstance(kind, type) and issubclass(kind, Term)):
        raise ValueError(f"from_config: '{name}' is no term")
    known = [field.name for field in fields(kind)]
    values = {key: _value(value) for key, value in config.items() if key != "term"}
    for key in values:
        if key not in known:
            raise unknown(f"field of '{name}'", key, known)
    try:
        return kind(**values)
    except TypeError as error:
        raise ValueError(f"from_config: '{name}': {error}") from error


def _data(value: Any) -> Any:
    if isinstance(value, Term):
        return to_config(value)
    if isinstance(value, tuple):
        return [_data(each) for each in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"to_config: a term holds numbers, words, terms and tuples, not {value!r}")


def _value(data: Any) -> Any:
    if isinstance(data, Mapping):
        return from_config(data)
    return tuple(_value(each) for each in data) if isinstance(data, list | tuple) else data
