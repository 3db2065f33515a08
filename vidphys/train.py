"""One training loop for everything that learns: heads, encoders, trackers, readouts."""

from __future__ import annotations

import copy
import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch
from torch import Generator, Tensor, nn

from vidphys import checkpoint


class Batches(Protocol):
    """Anything that can be indexed by a vector of example numbers."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: Tensor) -> Any: ...


Loss = Callable[[Any], Tensor]
Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class FitSettings:
    """How long and how fast.

    Args:
        steps: optimiser steps.
        batch: examples a step, drawn with replacement.
        learning_rate: peak of the one-cycle schedule of Adam.
        clip: largest gradient norm; 0 clips nothing.
        save_every: optimiser steps between checkpoints.
    """

    steps: int
    batch: int
    learning_rate: float
    clip: float = 0.0
    save_every: int = 500


@dataclass(frozen=True)
class FitResult:
    """What a training run leaves in the record."""

    steps: int
    final_loss: float
    learning_rate: float


def fit(
    modules: nn.Module,
    loss: Loss,
    data: Batches,
    settings: FitSettings,
    seed: int,
    save_to: Path | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Minimise ``loss(data[index])`` over the parameters of ``modules``, in place.

    Interrupted and called again with the same ``save_to``, it goes on from the last checkpoint
    and ends with the same weights, bit for bit, as a run that was not interrupted (CPU).

    Args:
        modules: what is trained (group several in an ``nn.ModuleList``).
        loss: a scalar from one batch.
        data: examples.
        settings: see :class:`FitSettings`.
        seed: of the batch order.
        save_to: JSON path of the checkpoint; ``None`` keeps none.
        progress: called as ``(step, steps, loss)``.

    Raises:
        FloatingPointError: the loss is not finite; nothing is updated by it.
    """
    run = _Run(modules, settings, seed)
    if save_to is not None and save_to.exists():
        run.load(save_to)
    with _finish_step_on_signal() as interrupted:
        while run.step < settings.steps:
            index = torch.randint(len(data), (settings.batch,), generator=run.rng)
            run.update(loss(data[index]))
            if progress is not None:
                progress(run.step, settings.steps, run.loss)
            due = run.step % settings.save_every == 0 or run.step == settings.steps
            if save_to is not None and (due or interrupted.is_set()):
                run.save(save_to)
            if interrupted.is_set():
                raise KeyboardInterrupt
    return FitResult(run.step, run.loss, settings.learning_rate)


class _Run:
    """The whole state of a training run; what a checkpoint holds."""

    def __init__(self, modules: nn.Module, settings: FitSettings, seed: int) -> None:
        self.modules, self.settings = modules, settings
        self.parameters = [p for p in modules.parameters() if p.requires_grad]
        self.optimiser = torch.optim.Adam(self.parameters, settings.learning_rate)
        self.rng = Generator().manual_seed(seed)
        self.step, self.loss = 0, math.nan

    def update(self, loss: Tensor) -> None:
        self.loss = float(loss.detach())
        if not math.isfinite(self.loss):
            raise FloatingPointError(f"training: the loss is {self.loss} at step {self.step}")
        for group in self.optimiser.param_groups:
            group["lr"] = self.settings.learning_rate * one_cycle(self.step / self.settings.steps)
        self.optimiser.zero_grad()
        loss.backward()
        if self.settings.clip:
            nn.utils.clip_grad_norm_(self.parameters, self.settings.clip)
        self.optimiser.step()
        self.step += 1

    def save(self, path: Path) -> None:
        tensors = {f"model/{k}": v for k, v in self.modules.state_dict().items()}
        for i, parameter in enumerate(self.parameters):
            for name, value in self.optimiser.state[parameter].items():
                tensors[f"adam/{i}/{name}"] = value
        tensors["rng"] = self.rng.get_state()
        meta = {"step": self.step, "loss": self.loss, "settings": asdict(self.settings)}
        checkpoint.save(path, tensors, meta)

    def load(self, path: Path) -> None:
        tensors, meta = checkpoint.load(path)
        if meta["settings"] != asdict(self.settings):
            raise checkpoint.InputError(
                f"checkpoint {path}: made with other settings {meta['settings']}; use another "
                "--out, or delete it"
            )
        prefix = "model/"
        self.modules.load_state_dict(
            {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
        )
        for i, parameter in enumerate(self.parameters):
            self.optimiser.state[parameter] = {
                k.split("/")[2]: v for k, v in tensors.items() if k.startswith(f"adam/{i}/")
            }
        self.rng.set_state(tensors["rng"])
        self.step, self.loss = meta["step"], meta["loss"]


WARM_UP = 0.1


def one_cycle(progress: float) -> float:
    """Learning-rate factor: linear warm-up over the first tenth, then a cosine to zero."""
    if progress < WARM_UP:
        return 0.04 + 0.96 * progress / WARM_UP
    return 0.5 * (1 + math.cos(math.pi * (progress - WARM_UP) / (1 - WARM_UP)))


@contextmanager
def _finish_step_on_signal() -> Iterator[threading.Event]:
    """Turn SIGINT and SIGTERM into an event that the loop sees after a whole step."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    kept = {
        number: signal.signal(number, lambda *_: event.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield event
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


@dataclass(frozen=True)
class LearningRateChoice:
    """The grid, the held-out error of each rate, and the one that was taken."""

    errors: dict[float, float]
    chosen: float


Model = TypeVar("Model", bound=nn.Module)


def choose_learning_rate(
    module: Model,
    loss: Callable[[Model], Loss],
    data: Batches,
    held_out: Any,
    grid: tuple[float, ...],
    probe: FitSettings,
    seed: int,
) -> LearningRateChoice:
    """Short runs from the same initial weights; the smallest held-out loss wins.

    Args:
        module: left as it was.
        loss: gives the batch loss of a copy of the module.
        data, held_out: training examples, and one batch that is scored.
        grid: candidate rates; a single one is taken without a run.
        probe: settings of the short runs; its rate is replaced.
        seed: of the batch order, shared by the candidates.
    """
    if len(grid) == 1:
        return LearningRateChoice({}, grid[0])
    errors = {}
    for rate in grid:
        candidate = copy.deepcopy(module)
        batch_loss = loss(candidate)
        try:
            fit(candidate, batch_loss, data, _with_rate(probe, rate), seed)
            with torch.no_grad():
                error = float(batch_loss(held_out))
            errors[rate] = error if math.isfinite(error) else math.inf
        except FloatingPointError:
            errors[rate] = math.inf
    return LearningRateChoice(errors, min(errors, key=lambda r: errors[r]))


def _with_rate(settings: FitSettings, rate: float) -> FitSettings:
    return FitSettings(**{**asdict(settings), "learning_rate": rate})
