"""One model in training: its optimiser and schedule, when it ends, and what is kept of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from dynamics import Head
from dynamics.compiled.graphs import recorded
from loops.threads import held_to
from vidphys.errors import InputError
from vidphys.placement import device_of
from vidphys.runs.checkpoint import under
from vidphys.training.early_stopping import BestWeights
from vidphys.training.ensemble import Ensemble
from vidphys.training.recorded import Recording

Loss = Callable[[Any], Tensor]
OnNan = Literal["stop", "skip"]
WARM_UP = 0.1
MOST_SKIPPED = 0.1  # of the steps, beyond which a training that skips batches is lost too
SMALL = 2**18  # numbers that one thread updates in a sixth of a millisecond


@runtime_checkable
class Several(Protocol):
    """Models side by side, of which one may be lost without the others."""

    def finite_members(self) -> Tensor:
        """Whether each member's gradient is finite, ``(members,)``."""
        ...


@dataclass(frozen=True)
class FitSettings:
    """How long and how fast.

    Args:
        steps: optimiser steps.
        batch: examples a step, drawn with replacement.
        learning_rate: peak of the one-cycle schedule of Adam.
        clip: largest gradient norm; 0 clips nothing.
        save_every: optimiser steps between checkpoints.
        on_nan: of a batch whose loss or gradient is not finite: ``stop`` loses the training,
            ``skip`` leaves the batch out, which counts as a step, of up to a tenth of all steps.
    """

    steps: int
    batch: int
    learning_rate: float
    clip: float = 0.0
    save_every: int = 500
    on_nan: OnNan = "stop"


class Learner:
    """A model with all that its training needs to be stopped and to go on.

    Args:
        modules: what is trained (group several in an ``nn.ModuleList``), in place.
        loss: a scalar from one batch.
        settings: see :class:`FitSettings`.
        best: ends the training early and remembers the best weights; ``None`` does neither.
    """

    def __init__(
        self,
        modules: nn.Module,
        loss: Loss,
        settings: FitSettings,
        best: BestWeights | None = None,
    ) -> None:
        self.modules, self.batch_loss, self.settings, self.best = modules, loss, settings, best
        self.parameters = [p for p in modules.parameters() if p.requires_grad]
        # Heads are so small that a card would wait for Python; what sees is not.
        self.records = isinstance(modules, (Head, Ensemble)) and device_of(modules).type == "cuda"
        self.recording: Recording | None = None
        self.recorded_change: Callable[[], Any] | None = None
        self.changed = False
        rate = settings.learning_rate
        self.optimiser = torch.optim.Adam(
            self.parameters,
            torch.tensor(rate, device=device_of(modules)) if self.records else rate,
            fused=True,
            capturable=self.records,
        )
        self.step, self.loss = 0, math.nan
        self.lost, self.why, self.skipped = False, "", 0

    @property
    def done(self) -> bool:
        """Whether no further step is to be taken: all were, none helps any more, or it is lost."""
        stopped = self.best is not None and self.best.exhausted
        return self.lost or stopped or self.step >= self.settings.steps

    def update(self, batch: Any) -> None:
        """One step; a loss or a gradient that is not finite updates nothing.

        ``why`` then says so, and ``lost`` whether that is the end of the training.
        """
        before, self.why = self.loss, ""
        self.loss, largest = self._loss_and_gradient(batch)
        if not math.isfinite(self.loss):
            self.why = f"the loss is {self.loss}"
        elif not (math.isfinite(largest) or self._has_finite_members()):
            self.why = "the gradient is not finite"
        else:
            self._descend()
        if self.why:
            most = MOST_SKIPPED * self.settings.steps
            self.lost = self.settings.on_nan == "stop" or self.skipped + 1 > most
            if self.lost:
                return
            self.skipped, self.loss = self.skipped + 1, before
        self.step += 1
        if self.best is not None:
            self.best.look(self.step, last=self.step == self.settings.steps)

    def _loss_and_gradient(self, batch: Any) -> tuple[float, float]:
        """Loss and largest gradient of a batch; the gradient is in the parameters."""
        if self.records:
            try:
                if self.recording is None:
                    self.recording = Recording(self.batch_loss, self.parameters, batch)
                return self.recording(batch)
            except RuntimeError:  # a loss that asks the card for numbers, or batches of other sizes
                self.records, self.recording = False, None
        self.optimiser.zero_grad()
        loss = self.batch_loss(batch)
        if math.isfinite(value := float(loss.detach())):
            loss.backward()
        gradients = [p.grad for p in self.parameters if p.grad is not None]
        largest = nn.utils.get_total_norm(gradients, math.inf) if gradients else 0.0
        return value, float(largest)

    def _descend(self) -> None:
        """Change the weights by their gradient."""
        rate = self.settings.learning_rate * one_cycle(self.step / self.settings.steps)
        for group in self.optimiser.param_groups:
            if self.recording is None:
                group["lr"] = rate
            else:
                group["lr"].fill_(rate)
        if self.recording is None or not self.changed:  # the first, which sets all up, as it is
            self._change()
            self.changed = True
            return
        if self.recorded_change is None:
            self.recorded_change = recorded(self._change)
        self.recorded_change()

    def _change(self) -> None:
        if self.settings.clip:
            nn.utils.clip_grad_norm_(self.parameters, self.settings.clip)
        # One thread for what one does at once: others would spin for milliseconds afterwards, where
        # the next step's fused loops want to run.
        small = sum(p.numel() for p in self.parameters) <= SMALL
        with held_to(1) if small else nullcontext():
            self.optimiser.step()

    def _has_finite_members(self) -> bool:
        """Whether several models are trained, and one at least has a finite gradient."""
        return isinstance(self.modules, Several) and bool(self.modules.finite_members().any())

    def tensors(self) -> dict[str, Tensor]:
        """What a checkpoint holds of it."""
        kept = {f"model/{k}": v for k, v in self.modules.state_dict().items()}
        for i, parameter in enumerate(self.parameters):
            for name, value in self.optimiser.state[parameter].items():
                kept[f"adam/{i}/{name}"] = value
        best = {} if self.best is None else self.best.tensors()
        return kept | {f"best/{k}": v for k, v in best.items()}

    def meta(self) -> dict[str, Any]:
        """Beside the tensors, as plain data."""
        loss = self.loss if math.isfinite(self.loss) else None
        about = {"step": self.step, "loss": loss, "settings": _lasting(asdict(self.settings))}
        about |= {"skipped": self.skipped} if self.skipped else {}
        return about | ({"lost": self.why, "loss": None} if self.lost else {})

    def load(self, tensors: Mapping[str, Tensor], meta: Mapping[str, Any]) -> None:
        """Go on from a checkpoint.

        Raises:
            InputError: it was made with other settings.
        """
        if _lasting(meta["settings"]) != _lasting(asdict(self.settings)):
            raise InputError(
                f"made with other settings {meta['settings']}; use another folder, or delete it"
            )
        self.modules.load_state_dict(under("model", tensors))
        for i, parameter in enumerate(self.parameters):
            kept = under(f"adam/{i}", tensors)
            self.optimiser.state[parameter] = {k: _laid_out(v, parameter) for k, v in kept.items()}
        if self.best is not None:
            self.best.load(under("best", tensors))
        # one of before a loss could be skipped was lost where it had none
        self.lost = "lost" in meta or (meta["loss"] is None and "skipped" not in meta)
        self.why, self.skipped = meta.get("lost", ""), meta.get("skipped", 0)
        self.step, self.loss = meta["step"], math.nan if meta["loss"] is None else meta["loss"]


def _lasting(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Those that make no other training where they change between two parts of it."""
    return {name: value for name, value in settings.items() if name != "on_nan"}


def _laid_out(value: Tensor, parameter: Tensor) -> Tensor:
    """In memory as its parameter is: fused Adam takes the two for granted to be alike."""
    return torch.empty_like(parameter).copy_(value) if value.dim() else value.to(parameter.device)


def one_cycle(progress: float) -> float:
    """Learning-rate factor: linear warm-up over the first tenth, then a cosine to zero."""
    if progress < WARM_UP:
        return 0.04 + 0.96 * progress / WARM_UP
    return 0.5 * (1 + math.cos(math.pi * (progress - WARM_UP) / (1 - WARM_UP)))
