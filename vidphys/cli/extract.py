"""``vidphys extract``: features of clips by a frozen encoder, into a store."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.devices import check_cuda
from vidphys.cli.profiles import with_profile
from vidphys.data.video import ClipSelection, Video, read_video
from vidphys.errors import InputError

if TYPE_CHECKING:
    from encoders.frozen import FrozenEncoder
    from vidphys.training.loop import Progress


OPTIONS = (
    "layer",
    "resolution",
    "frames",
    "hop",
    "frame_stride",
    "predictor",
    "dtype",
    "batch",
    "runtime",
)


@dataclass(frozen=True)
class ExtractConfig:
    """Encode clips with a frozen encoder; what the store holds already is not encoded again.

    Example: vidphys extract clip.mp4 --out features --weights weights --layer 8

    Args:
        clips: video files.
        out: folder of the feature store; made if it is not there.
        encoder: the frozen encoder; `vidphys weights list` names them. The options from layer to
            runtime keep its own default where they are not given; one that it does not take is
            refused.
        weights: file or folder of its weights; else VIDPHYS_WEIGHTS, else the user's cache.
        layer: what is read: hiera 4, 8, 16 or 32 (stride in network pixels); i3d a stage, such as
            Mixed_4f; the transformers a number of blocks.
        resolution: network pixels of the longer image side.
        frames: in a window of a video encoder.
        hop: frames from a window's start to the next one's.
        frame_stride: let the encoder take each so-many-th of the frames.
        predictor: read the predictor of V-JEPA 2 in place of its encoder.
        dtype: of the computation.
        batch: frames, or windows of a video encoder, per forward pass.
        runtime: what computes the network, for encoders that have a choice.
        profile: take what it sets of this verb from a point that `vidphys trade --pick` chose.
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
    encoder: str = "hiera"
    weights: Path | None = None
    layer: int | str | None = None
    resolution: int | None = None
    frames: int | None = None
    hop: int | None = None
    frame_stride: int | None = None
    predictor: bool = False
    dtype: Literal["float32", "bfloat16", "float16"] | None = None
    batch: int | None = None
    runtime: Literal["torch", "compile", "openvino"] | None = None
    profile: Path | None = None
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

    @property
    def options(self) -> dict[str, Any]:
        """What the encoder is set to; ``None`` is its own default."""
        given = {name: getattr(self, name) for name in OPTIONS}
        return {**given, "predictor": self.predictor or None}


def extract(config: ExtractConfig) -> None:
    """Extract the features of every clip and say how fast and how many were there already.

    Raises:
        InputError: no clip, a clip that cannot be read, weights that are missing or wrong, a
            device that is not there, or a damaged store entry.
    """
    config = with_profile(config, "extract")
    if not config.clips:
        raise InputError("extract: no clips; name at least one video file")
    for path in config.clips:
        if not path.is_file():
            raise InputError(f"extract: {path}: no such file; nothing was extracted")
    try:
        _extract_all(config, frozen_encoder(config))
    except ValueError as error:
        raise InputError(str(error)) from error


def frozen_encoder(config: ExtractConfig) -> FrozenEncoder:
    """The encoder that a configuration names.

    Raises:
        InputError: a device that is not there.
        ValueError: an unknown encoder, an option that it does not take, or weights that are missing
            or wrong.
    """
    from encoders.frozen import load_encoder

    check_cuda(config.device)
    return load_encoder(config.encoder, config.options, config.weights, config.device)


def _extract_all(config: ExtractConfig, encoder: FrozenEncoder) -> None:
    from encoders.store import FeatureStore
    from vidphys.data import extraction

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
