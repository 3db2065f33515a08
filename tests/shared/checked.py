"""Shapes are checked at run time in the first calls of each test: later ones of a loop look alike.

It is the checker that jaxtyping is given in ``pyproject.toml``. Checking every step of a rollout of
thousands takes several times as long as the steps.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any

import beartype
import jaxtyping

MOST = 5_000  # checks of a test; a call whose result is annotated has two
_done = 0


def begin() -> None:
    """A test begins: everything is checked."""
    global _done
    _done = 0
    jaxtyping.config.update("jaxtyping_disable", False)


def first_calls(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose calls beartype checks until the test has had its share."""
    checked = beartype.beartype(function)

    @wraps(function)
    def counted(*args: Any, **kwargs: Any) -> Any:
        global _done
        _done += 1
        if _done == MOST:
            jaxtyping.config.update("jaxtyping_disable", True)
        return checked(*args, **kwargs)

    return counted
