"""A factory of encoders: what they are set by, and what loads one."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.differenced import Differenced

WHERE = ("weights", "device")  # what a factory may be told beside its encoder's options


@dataclass(frozen=True)
class Adapter:
    """A factory of encoders: what they are set by, and what loads one.

    Args:
        settings: a dataclass; its fields are the options.
        load: from settings, place of the weights and device.
    """

    settings: type[Any]
    load: Callable[[Any, Path | None, str], FrozenEncoder]

    def __call__(
        self, *, weights: Path | None = None, device: str = "cpu", **options: Any
    ) -> FrozenEncoder:
        settings = self.settings(**options)
        made = self.load(settings, weights, device)
        reach: int | None = getattr(settings, "difference", None)
        return made if reach is None else Differenced(made, reach)

    @property
    def __signature__(self) -> inspect.Signature:
        named = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY) for name in WHERE]
        own = inspect.signature(self.settings).parameters.values()
        return inspect.Signature([*own, *named])
