"""The weights that were best on what was held out, and when to stop looking for better ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class StopSettings:
    """When a training looks at what was held out, and when it gives up.

    Args:
        evaluations: over the whole training, evenly spread.
        patience: so many evaluations in a row without a smaller error end it; 0 never does.
    """

    evaluations: int = 40
    patience: int = 0


class BestWeights:
    """Follows one training.

    Args:
        module: what is trained.
        error: of the module as it is, on what is held out.
        steps: of the whole training.
        settings: see :class:`StopSettings`.
    """

    def __init__(
        self, module: nn.Module, error: Callable[[], float], steps: int, settings: StopSettings
    ) -> None:
        self.module, self.held_out_error = module, error
        self.every = max(1, steps // settings.evaluations)
        self.patience = settings.patience
        self.error, self.step, self.since = math.inf, 0, 0
        self.weights = _copy(module)

    @property
    def exhausted(self) -> bool:
        """Whether the patience has run out."""
        return 0 < self.patience <= self.since

    def look(self, step: int, last: bool) -> None:
        """Evaluate, if it is time to, and remember the weights if they are the best so far."""
        if step % self.every and not last:
            return
        error = self.held_out_error()
        self.since += 1
        if error < self.error:
            self.error, self.step, self.since = error, step, 0
            self.weights = _copy(self.module)

    def restore(self) -> None:
        """Give the module its best weights back."""
        self.module.load_state_dict(self.weights)

    def tensors(self) -> dict[str, Tensor]:
        """What a checkpoint holds of it."""
        counts = torch.tensor([self.error, self.step, self.since], dtype=torch.float64)
        return {"counts": counts} | {f"weights/{k}": v for k, v in self.weights.items()}

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Inverse of :meth:`tensors`."""
        error, step, since = tensors["counts"].tolist()
        self.error, self.step, self.since = error, int(step), int(since)
        start = "weights/"
        self.weights = {k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)}


def _copy(module: nn.Module) -> dict[str, Tensor]:
    return {k: v.detach().clone() for k, v in module.state_dict().items()}
