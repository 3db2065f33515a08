"""Names of a package that are imported when they are first touched (PEP 562)."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Any


def lazily(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The ``__getattr__`` and ``__dir__`` of a package whose names lie in its modules.

    Args:
        package: its ``__name__``.
        homes: the module that each name lies in, or which it is.

    Example:
        >>> get, names = lazily("registry", {"sqrt": "math"})
        >>> get("sqrt")(9.0), "sqrt" in names()
        (3.0, True)
        >>> get("root")
        Traceback (most recent call last):
        AttributeError: module 'registry' has no attribute 'root'
    """

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        home = importlib.import_module(homes[name])
        return home if home.__name__ == f"{package}.{name}" else getattr(home, name)

    return get, lambda: sorted({*vars(sys.modules[package]), *homes})
