"""``vidphys extract``: features of clips by a frozen encoder, into a store."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.errors import InputError
from vidphys.video import ClipSelection, Video, read_video

if TYPE_CHECKING:
    from encoders.frozen import HieraEncoder
    from vidphys.train import Progress


@dataclass(frozen=True)
class ExtractConfig:
    """Encode clips with a frozen encoder; what the store holds already is not encoded again.

    Example: vidphys extract clip.mp4 --out features --weights weights --layer 8

    Args:
        clips: video files.
        out: folder of the feature store; made if it is not there.
        encoder: the frozen encoder.
        weights: file or folder of its weights; else VIDPHYS_WEIGHTS, else the user's cache.
        layer: the stage that is read, by its stride in network pixels.
        resolution: network pixels of the longer image side, a multiple of 32.
        dtype: of the computation.
        batch: frames per forward pass.
        store_dtype: of the values on disk.
        start: first frame of each clip.
        stop: frame to stop before.
        stride: take each so-many-th frame.
        side: shrink frames so that their longer side has at most this many pixels.
        rate: frames per second, in place of the container's time stamps.
        device: where the encoder runs.
        quiet: show no progress.
    """

    clips: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Path
    encoder: Literal["hiera"] = "hiera"
    weights: Path | None = None
    layer: Literal[4, 8, 16, 32] = 8
    resolution: int = 128
    dtype: Literal["float32", "bfloat16", "float16"] = "float32"
    batch: int = 8
    store_dtype: Literal["float16", "bfloat16", "float32"] = "float16"
    start: int = 0
    stop: int | None = None
    stride: int = 1
    side: int | None = None
    rate: float | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    quiet: bool = False

    @property
    def selection(self) -> ClipSelection:
        """Which frames are read."""
        return ClipSelection(self.start, self.stop, self.stride, self.side, self.rate)


def extract(config: ExtractConfig) -> None:
    """Extract the features of every clip and say how fast and how many were there already.

    Raises:
        InputError: no clip, a clip that cannot be read, weights that are missing or wrong, a
            device that is not there, or a damaged store entry.
    """
    if not config.clips:
        raise InputError("extract: no clips; name at least one video file")
    for path in config.clips:
        if not path.is_file():
            raise InputError(f"extract: {path}: no such file; nothing was extracted")
    try:
        _extract_all(config, frozen_encoder(config))
    except ValueError as error:
        raise InputError(str(error)) from error


def frozen_encoder(config: ExtractConfig) -> HieraEncoder:
    """The encoder that a configuration names.

    Raises:
        InputError: a device that is not there.
        ValueError: weights that are missing or wrong.
    """
    import torch

    from encoders.frozen import HieraSettings, load_hiera

    if config.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: this machine has no CUDA device; use --device cpu")
    settings = HieraSettings(config.layer, config.resolution, config.dtype, config.batch)
    return load_hiera(settings, config.weights, config.device)


def _extract_all(config: ExtractConfig, encoder: HieraEncoder) -> None:
    from encoders.store import FeatureStore
    from vidphys import extraction

    store = FeatureStore(config.out)
    started, frames = time.perf_counter(), 0
    with Console(config.quiet, len(config.clips), "extract") as console:
        for number, path in enumerate(config.clips):
            video = read_video(path, config.selection)
            show = _stage_of(console, path.name)
            found = extraction.extract(video, encoder, store, config.store_dtype, show)
            console.done(number)
            console.result(_summary(video, found.features.values.shape, found.cached))
            frames += len(video.frames)
        store.write_index()
        seconds = time.perf_counter() - started
        console.result(
            f"{len(config.clips)} clips, {frames} frames in {seconds:.1f} s: "
            f"{len(config.clips) / seconds:.3g} clips/s, {frames / seconds:.3g} frames/s, "
            f"hit rate {store.hit_rate:.0%}; store {config.out}"
        )


def _stage_of(console: Console, name: str) -> Progress:
    return lambda step, steps, _: console.stage((name, step, steps))


def _summary(video: Video, shape: tuple[int, ...], cached: bool) -> str:
    _, t, c, h, w = shape
    state = "in store" if cached else "extracted"
    first = f"{video.path}: {state}, {t} frames of {c} channels on a {h} x {w} grid"
    return "\n".join([first, *(f"{video.path}: note: {note}" for note in video.notes)])
