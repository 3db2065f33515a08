"""One pretraining: train an objective, and write what it learned as a release folder."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import torch
from torch import Tensor, nn

from encoders.release import CONFIG, TENSORS, release_sha256
from vidphys.errors import InputError
from vidphys.pretraining.clips import COUPLINGS, Examples, Layout, RandomClips, Signs
from vidphys.pretraining.dino import PatchDistillation
from vidphys.pretraining.videomae import MaskedAutoencoding
from vidphys.pretraining.vjepa2 import FeaturePrediction
from vidphys.progress import Progress
from vidphys.runs.atomic import write_json, write_tensors, write_with
from vidphys.seeding import derive
from vidphys.training.loop import FitSettings, fit

RECORD = "pretraining.json"
CHECKPOINT = "checkpoint.json"
PACKAGES = ("torch", "transformers", "timm", "vidphys")
TRAJECTORIES = 128  # for each number of bodies
WATCHED, WATCHED_AT_ONCE = 64, 16  # examples


class Objective(Protocol):
    """What can be pretrained: a module that gives a loss, and in the end a release."""

    layout: Layout

    def __call__(self, batch: Examples) -> Tensor: ...

    def after_step(self, step: int, steps: int) -> None: ...

    def features(self, batch: Examples) -> Tensor: ...

    def release(self) -> tuple[dict[str, Any], dict[str, Tensor]]: ...


OBJECTIVES: dict[str, Callable[[], nn.Module]] = {
    "videomae-tiny": MaskedAutoencoding,
    "vjepa2-tiny": FeaturePrediction,
    "dino-tiny": PatchDistillation,
}
TOY = FitSettings(20, 4, 1.5e-3, 1.0)
SHIPPED = {  # one to four minutes of one core each
    "videomae-tiny": FitSettings(400, 8, 1.5e-3, 1.0, save_every=100),
    "vjepa2-tiny": FitSettings(300, 8, 1.5e-3, 1.0, save_every=100),
    "dino-tiny": FitSettings(2000, 8, 1.5e-3, 1.0, save_every=100),
}


@dataclass(frozen=True)
class Watched:
    """How an objective does.

    Args:
        loss: of the objective.
        deviation: standard deviation of the features between examples, at the same token, mean
            over tokens and channels. It is zero where an encoder has collapsed: where it says the
            same whatever it sees.
    """

    loss: float
    deviation: float


@dataclass(frozen=True)
class Pretrained:
    """What a pretraining leaves in its record.

    Args:
        before, after: the training, on examples that it does not see.
        sha256: of the release.
    """

    before: Watched
    after: Watched
    sha256: str


def pretrain(
    name: str,
    settings: FitSettings,
    out: Path,
    seed: int,
    device: str = "cpu",
    progress: Progress | None = None,
    signs: Signs = "both",
) -> Pretrained:
    """Train an encoder without labels and write its release folder.

    Interrupted and called again, it goes on from its checkpoint; on a CPU, the same settings and
    seed give the same weights.

    Args:
        name: a key of ``OBJECTIVES``.
        settings: of the optimiser.
        out: the release folder; a checkpoint lies there until the end.
        seed: of initial weights, clips and order.
        device: of the training.
        progress: called as ``(step, steps, loss)``.
        signs: of the couplings of the clips; all else is drawn alike.

    Raises:
        InputError: unknown name, or the folder's checkpoint is of another name, seed, couplings or
            settings.
    """
    if name not in OBJECTIVES:
        raise InputError(f"pretraining {name}: unknown; use one of {', '.join(OBJECTIVES)}")
    torch.manual_seed(derive(seed, "init", name))
    module = OBJECTIVES[name]().to(device)
    objective = cast(Objective, module)
    data = RandomClips(TRAJECTORIES, objective.layout, derive(seed, "clips", name), device, signs)
    unseen = RandomClips(1, objective.layout, derive(seed, "unseen", name), device, signs)
    before = watch(module, unseen)

    def after_step(step: int, steps: int, loss: float) -> None:
        objective.after_step(step, steps)
        if progress is not None:
            progress(step, steps, loss)

    checkpoint, order = out / CHECKPOINT, derive(seed, "order", name)
    of = {"name": name, "couplings": signs, "seed": seed}
    fit(module, objective, data, settings, order, checkpoint, after_step, of)
    sha256 = write_release(out, *objective.release())
    result = Pretrained(before, watch(module, unseen), sha256)
    _record(out, name, settings, seed, device, signs, result)
    for file in out.glob(f"{checkpoint.stem}*"):
        file.unlink()
    return result


@torch.no_grad()
def watch(module: nn.Module, clips: RandomClips) -> Watched:
    """Loss and spread of features on the first examples; the module is left as it was."""
    objective = cast(Objective, module.eval())
    batches = [clips[part] for part in torch.arange(WATCHED).split(WATCHED_AT_ONCE)]
    losses = torch.stack([objective(batch) for batch in batches])
    features = torch.cat([objective.features(batch) for batch in batches])
    module.train()
    return Watched(float(losses.mean()), float(features.std(0).mean()))


def write_release(out: Path, config: dict[str, Any], tensors: dict[str, Tensor]) -> str:
    """Write ``config.json`` and half-precision ``model.safetensors``; returns the hash."""
    halves = {k: v.detach().cpu().half().contiguous() for k, v in tensors.items()}
    # as the hub's libraries write it: they refuse a file that does not name its framework
    write_tensors(out / TENSORS, halves, {"format": "pt"})
    text = json.dumps(config, indent=2, sort_keys=True) + "\n"
    write_with(out / CONFIG, lambda partial: partial.write_text(text, encoding="utf-8"))
    return release_sha256(out)


def _record(
    out: Path,
    name: str,
    settings: FitSettings,
    seed: int,
    device: str,
    signs: Signs,
    result: Pretrained,
) -> None:
    versions = {package: importlib.metadata.version(package) for package in PACKAGES}
    record = {
        "schema_version": 2,
        "name": name,
        "settings": asdict(settings),
        "couplings": {"signs": signs, "range": COUPLINGS[signs]},
        "seed": seed,
        "device": device,
        "versions": versions,
        **asdict(result),
    }
    write_json(out / RECORD, record)
