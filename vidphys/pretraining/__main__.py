"""``python -m vidphys.pretraining NAME --out DIR``: make one of the tiny encoders anew."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import torch
import tyro

from vidphys.devices import prepare_device
from vidphys.errors import InputError
from vidphys.pretraining.clips import Signs
from vidphys.pretraining.run import RECORD, SHIPPED, TOY, pretrain

EVERY = 50


@dataclass(frozen=True)
class PretrainConfig:
    """Pretrain a tiny encoder on rendered clips, without labels, and write its release folder.

    Example: python -m vidphys.pretraining dino-tiny --out weights/dino-tiny

    Args:
        name: which encoder.
        out: its release folder; the same command goes on after an interruption, and does nothing
            more after the end.
        preset: how long; `shipped` made the weights in the package.
        steps: of the training, in place of the preset's.
        couplings: of the clips: of both signs, or attraction alone, as of the encoders of the
            package whose names end in -attraction.
        seed: of initial weights, clips and order.
        device: of the training.
    """

    name: Annotated[Literal["videomae-tiny", "vjepa2-tiny", "dino-tiny"], tyro.conf.Positional]
    out: Path
    preset: Literal["toy", "shipped"] = "shipped"
    steps: int | None = None
    couplings: Signs = "both"
    seed: int = 0
    device: Literal["cpu", "cuda"] = "cpu"


def _show(step: int, steps: int, loss: float) -> None:
    if step % EVERY == 0 or step == steps:
        print(f"step {step} of {steps}: loss {loss:.5f}", flush=True)


def main() -> int:
    """Returns the exit code: 0 done, 2 wrong input, 130 interrupted."""
    config = tyro.cli(PretrainConfig, prog="python -m vidphys.pretraining")
    torch.set_num_threads(1)
    try:
        prepare_device(config.device)
        settings = SHIPPED[config.name] if config.preset == "shipped" else TOY
        if config.steps is not None:
            settings = replace(settings, steps=config.steps)
        ended = (config.out / RECORD).exists()
        result = pretrain(
            config.name,
            settings,
            config.out,
            config.seed,
            config.device,
            _show,
            config.couplings,
        )
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    if ended:
        print(f"{config.out}: made before by this command; nothing is trained again")
    for when, watched in (("before", result.before), ("after", result.after)):
        print(f"{when}: loss {watched.loss:.5f}, features' deviation {watched.deviation:.3f}")
    print(f"{config.name}: {config.out}, sha256 {result.sha256}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
