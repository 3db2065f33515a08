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
from vidphys.runs.lock import LOCK, locked
from vidphys.seeding import derive
from vidphys.training.loop import FitSettings, fit

RECORD = "pretraining.json"
CHECKPOINT = "checkpoint.json"
RELEASED = (RECORD, CONFIG, TENSORS)
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
    seed give the same weights. A folder where it has ended is left as it is.

    Args:
        name: a key of ``OBJECTIVES``.
        settings: of the optimiser.
        out: the release folder; a checkpoint lies there until the end.
        seed: of initial weights, clips and order.
        device: of the training.
        progress: called as ``(step, steps, loss)``.
        signs: of the couplings of the clips; all else is drawn alike.

    Raises:
        InputError: unknown name, no step, or a folder that cannot be written, or holds a release
            or checkpoint of another name, seed, couplings or settings.
    """
    if name not in OBJECTIVES:
        raise InputError(f"pretraining {name}: unknown; use one of {', '.join(OBJECTIVES)}")
    if settings.steps < 1:
        raise InputError(f"pretraining {name}: `steps` {settings.steps}: must be at least 1")
    ended = _ended(out, _told(name, asdict(settings), signs, seed))
    if ended is not None:
        return ended
    with locked(out):
        return _pretrain(name, settings, out, seed, device, progress, signs)


def _pretrain(
    name: str,
    settings: FitSettings,
    out: Path,
    seed: int,
    device: str,
    progress: Progress | None,
    signs: Signs,
) -> Pretrained:
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
    # a checkpoint's JSON before its tensors
    for file in (*sorted(out.glob(f"{checkpoint.stem}*"), reverse=True), out / LOCK):
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


def _ended(out: Path, asked: dict[str, Any]) -> Pretrained | None:
    """What a folder's record says, where its release is of the pretraining that is asked for.

    ``None`` where there is no release, or a pretraining was stopped while it wrote one.

    Raises:
        InputError: the release is of another pretraining, of unknown origin, or damaged.
    """
    if (out / CHECKPOINT).exists() or not any((out / file).exists() for file in RELEASED):
        return None
    try:
        held = json.loads((out / RECORD).read_text(encoding="utf-8"))
        made = _told(held["name"], held["settings"], held["couplings"]["signs"], held["seed"])
        before, after = (Watched(**held[when]) for when in ("before", "after"))
        if release_sha256(out) != held["sha256"]:
            raise ValueError("its weights do not fit their hash")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"pretraining: {out} holds other files than a pretraining leaves ({error}); use "
            "another folder"
        ) from error
    other = [key for key in asked if made.get(key) != asked[key]]
    if other:
        there, here = (", ".join(f"{k} {of.get(k)}" for k in other) for of in (made, asked))
        raise InputError(
            f"pretraining: {out} holds a release made with {there}, not {here}; use another folder"
        )
    return Pretrained(before, after, held["sha256"])


def _told(name: str, settings: dict[str, Any], signs: Signs, seed: int) -> dict[str, Any]:
    return {"name": name, "couplings": signs, "seed": seed, **settings}
