"""Presets: sizes, seeds and lengths as data. A preset is never another code path."""

from __future__ import annotations

from dataclasses import dataclass

from vidphys.errors import InputError


@dataclass(frozen=True)
class OracleSizes:
    """Training of a head on true states.

    Args:
        trajectories: of 20 steps each (the study's horizon).
        steps, batch: one-step training.
        learning_rates: grid, chosen on held-out one-step error.
        held_out: scored episodes.
    """

    trajectories: int
    steps: int
    batch: int
    learning_rates: tuple[float, ...]
    held_out: int


@dataclass(frozen=True)
class PixelSizes:
    """Perception and the training of a head on what it perceives.

    Args:
        clips: training clips of ``frames`` frames, ``stride`` reference steps apart; the held-out
            ones, which end at t0, are as long, on every rung.
        image: pixels on a side.
        perception_steps, perception_batch: frames a step, for encoders that learn.
        track_steps: training of a head on tracks, under each readout.
        held_out: scored clips.
        encounters: clips of bodies that hide each other, made for readouts over frozen encoders.
        readers: of the cells around a body, over frozen encoders.
    """

    clips: int
    frames: int
    stride: int
    image: int
    perception_steps: int
    perception_batch: int
    track_steps: int
    held_out: int
    encounters: int = 0
    readers: int = 1


@dataclass(frozen=True)
class Preset:
    """Everything that the ladder's size depends on."""

    seeds: int
    oracle: OracleSizes
    pixel: PixelSizes


PRESETS = {
    "quick": Preset(
        seeds=1,
        oracle=OracleSizes(2048, 600, 1024, (5e-3,), 32),
        pixel=PixelSizes(256, 12, 40, 32, 150, 64, 150, 32),
    ),
    "standard": Preset(
        seeds=3,
        oracle=OracleSizes(8192, 4000, 1024, (1e-2, 5e-3, 1e-3), 64),
        pixel=PixelSizes(1536, 16, 40, 64, 600, 128, 600, 64, 768, 3),
    ),
    "paper": Preset(
        seeds=10,
        oracle=OracleSizes(8192, 10_000, 1024, (1e-2, 5e-3, 1e-3), 64),
        pixel=PixelSizes(4096, 16, 40, 64, 3000, 256, 3000, 64, 2048, 3),
    ),
}


def preset(name: str) -> Preset:
    """Look a preset up.

    Raises:
        InputError: there is none of this name.

    Example:
        >>> preset("quick").seeds, preset("standard").seeds
        (1, 3)
    """
    if name not in PRESETS:
        raise InputError(f"`preset` {name}: unknown; use one of {', '.join(PRESETS)}")
    return PRESETS[name]
