"""One training loop for everything that learns: heads, encoders, trackers, readouts."""

from __future__ import annotations

import copy
import math
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import torch
from torch import Generator, Tensor, nn

from vidphys.errors import InputError
from vidphys.placement import device_of, moved
from vidphys.progress import Progress
from vidphys.runs import checkpoint
from vidphys.training.learner import FitSettings, Learner, Loss, one_cycle

__all__ = [
    "Batches",
    "FitResult",
    "FitSettings",
    "Learner",
    "Loss",
    "choose_learning_rate",
    "fit",
    "fit_together",
    "one_cycle",
]


NAMED = 16  # examples of a batch that a message names


class SkippedBatchWarning(UserWarning):
    """A batch whose loss or gradient is not finite was left out."""


class Batches(Protocol):
    """Anything that can be indexed by a vector of example numbers."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: Tensor) -> Any: ...


@runtime_checkable
class Drawing(Protocol):
    """Batches that are drawn by chance, whose generator belongs into a checkpoint."""

    rng: Generator


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
    of: Mapping[str, Any] | None = None,
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
        of: what is trained and on what, as plain data, where ``settings`` and ``modules`` do not
            tell; a checkpoint keeps it.

    Raises:
        InputError: the checkpoint is of another training, or damaged.
        FloatingPointError: the loss or its gradient is not finite; nothing is updated by it, and
            the checkpoint is that of before. The message names the batch.

    Example:
        >>> line = nn.Linear(1, 1)
        >>> x = torch.linspace(-1, 1, 64)[:, None]
        >>> def loss(batch):
        ...     return (line(batch) - 2 * batch - 1).square().mean()
        ...
        >>> result = fit(line, loss, x, FitSettings(steps=200, batch=64, learning_rate=0.1), seed=0)
        >>> round(line.weight.item(), 2), round(line.bias.item(), 2)
        (2.0, 1.0)
    """
    learner = Learner(modules, loss, settings)
    fit_together([learner], data, seed, save_to, progress, of)
    return FitResult(learner.step, learner.loss, settings.learning_rate)


def fit_together(
    learners: Sequence[Learner],
    data: Batches,
    seed: int,
    save_to: Path | None = None,
    progress: Progress | None = None,
    of: Mapping[str, Any] | None = None,
) -> None:
    """Train several models on the same batches, each of which is read once; see :func:`fit`.

    No learner knows of the others: each ends with the weights that it would have alone. One that
    is lost (its loss or gradient is not finite) or has stopped early takes no further step.

    Args:
        learners: of the same steps, batch and checkpoints, on one device, where batches go.
        data, seed, save_to, progress, of: see :func:`fit`; the loss told is the learners' mean.

    Raises:
        InputError: see :func:`fit`.
        FloatingPointError: all learners are lost.
    """
    plan = {(s.steps, s.batch, s.save_every) for s in (each.settings for each in learners)}
    if len(plan) != 1:
        raise ValueError(f"fit_together: needs one (steps, batch, save_every), got {sorted(plan)}")
    ((steps, size, save_every),) = plan
    device, rng = device_of(learners[0].modules), Generator().manual_seed(seed)
    rngs = {"rng": rng} | ({"data_rng": data.rng} if isinstance(data, Drawing) else {})
    if save_to is not None and save_to.exists():
        _load(save_to, learners, rngs, of)
    with _finish_step_on_signal() as interrupted:
        while live := [each for each in learners if not each.done]:
            index = torch.randint(len(data), (size,), generator=rng)
            batch = moved(data[index], device)
            for learner in live:
                learner.update(batch)
                if learner.why and not learner.lost:
                    _tell_skipped(learner, index)
            if all(each.lost for each in learners):
                why, step = live[0].why, live[0].step
                raise FloatingPointError(
                    f"training: {why} at step {step}, in the batch of {_named(index)}"
                )
            step = max(each.step for each in live)
            if progress is not None:
                kept = [each.loss for each in live if not each.lost]
                progress(step, steps, sum(kept) / len(kept) if kept else math.nan)
            due = step % save_every == 0 or all(each.done for each in learners)
            if save_to is not None and (due or interrupted.is_set()):
                _save(save_to, learners, rngs, of)
            if interrupted.is_set():
                raise KeyboardInterrupt


def _tell_skipped(learner: Learner, index: Tensor) -> None:
    warnings.warn(
        f"training: {learner.why} at step {learner.step - 1}, in the batch of {_named(index)}, "
        f"which is skipped, {learner.skipped} so far",
        SkippedBatchWarning,
        stacklevel=4,
    )


def _named(index: Tensor) -> str:
    """A batch by the numbers of its examples."""
    numbers = [str(i) for i in index[:NAMED].tolist()]
    return f"examples {', '.join(numbers)}" + (", ..." if len(index) > NAMED else "")


def _save(
    path: Path,
    learners: Sequence[Learner],
    rngs: Mapping[str, Generator],
    of: Mapping[str, Any] | None,
) -> None:
    tensors = {name: rng.get_state() for name, rng in rngs.items()}
    for i, learner in enumerate(learners):
        tensors |= {f"{i}/{k}": v for k, v in learner.tensors().items()}
    step = max(each.step for each in learners)
    meta = {"step": step, "learners": [each.meta() for each in learners]}
    meta |= {} if of is None else {"of": dict(of)}
    checkpoint.save(path, tensors, meta, keep_last=True)


def _load(
    path: Path,
    learners: Sequence[Learner],
    rngs: Mapping[str, Generator],
    of: Mapping[str, Any] | None,
) -> None:
    tensors, meta = checkpoint.load_good(path)
    if of is not None and meta.get("of") != dict(of):
        raise InputError(
            f"checkpoint {path}: made of {_pairs(meta.get('of'))}, not {_pairs(of)}; use another "
            "folder, or delete it"
        )
    made = len(meta.get("learners", ()))  # none in a checkpoint of before there were several
    if made != len(learners):
        raise InputError(
            f"checkpoint {path}: made with other settings ({made} models, not "
            f"{len(learners)}); use another folder, or delete it"
        )
    for i, (learner, about) in enumerate(zip(learners, meta["learners"], strict=True)):
        try:
            learner.load(checkpoint.under(str(i), tensors), about)
        except InputError as error:
            raise InputError(f"checkpoint {path}: {error}") from error
    for name, rng in rngs.items():
        rng.set_state(tensors[name])


def _pairs(of: Mapping[str, Any] | None) -> str:
    return ", ".join(f"{k} {v}" for k, v in of.items()) if of else "what it does not tell"


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
    errors, held_out = {}, moved(held_out, device_of(module))
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
