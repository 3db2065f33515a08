"""``vidphys extract``: features of clips by a frozen encoder, into a store."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.profiles import with_profile
from vidphys.cli.seeing import SeeingOptions
from vidphys.data.dataset import clips_of
from vidphys.data.sets import is_in_set
from vidphys.data.video import Video, open_video
from vidphys.devices import check_cuda
from vidphys.errors import InputError

if TYPE_CHECKING:
    from encoders.identity import IdentifiedEncoder
    from vidphys.progress import Progress


@dataclass(frozen=True)
class ExtractConfig(SeeingOptions):
    """Encode clips with a frozen encoder; what the store holds already is not encoded again.

    Example: vidphys extract clip.mp4 --out features --weights weights --layer 8

    Args:
        clips: video files, folders of them, data sets (of LeRobot, Hugging Face, WebDataset, HDF5,
            NPZ), or clips of one, named as if it were a folder (runs.h5/trial).
        out: folder of the feature store; made if it is not there.
        layer: what is read: hiera 4, 8, 16 or 32 (stride in network pixels); i3d a stage, such as
            Mixed_4f; the transformers a number of blocks.
        batch: frames, or windows of a video encoder, per forward pass.
        runtime: what computes the network, for encoders that have a choice.
        store_dtype: of the values on disk.
        profile: take what it sets of this verb from a point that `vidphys trade --pick` chose.
        quiet: show no progress.
    """

    clips: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Path
    layer: int | str | None = None
    batch: int | None = None
    runtime: Literal["torch", "compile", "openvino"] | None = None
    store_dtype: Literal["float16", "bfloat16", "float32"] = "float16"
    profile: Path | None = None
    quiet: bool = False

    @property
    def encoder_options(self) -> dict[str, Any]:
        """Those of one encoder at one layer, and how it computes."""
        how = {"layer": self.layer, "batch": self.batch, "runtime": self.runtime}
        return {**super().encoder_options, **how}


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
        if not path.exists() and not is_in_set(path):
            raise InputError(f"extract: {path}: no such file; nothing was extracted")
    clips = [clip for path in config.clips for clip in clips_of(path)]
    try:
        _extract_all(config, clips, frozen_encoder(config))
    except ValueError as error:
        raise InputError(str(error)) from error


def frozen_encoder(config: ExtractConfig) -> IdentifiedEncoder:
    """The encoder that a configuration names.

    Raises:
        InputError: a device that is not there.
        ValueError: an unknown encoder, an option that it does not take, or weights that are missing
            or wrong.
    """
    from encoders.frozen import load_encoder

    check_cuda(config.device)
    return load_encoder(config.encoder, config.encoder_options, config.weights, config.device)


def _extract_all(config: ExtractConfig, clips: Sequence[Path], encoder: IdentifiedEncoder) -> None:
    from encoders.store import FeatureStore
    from vidphys.data import extraction

    store = FeatureStore(config.out)
    started, frames = time.perf_counter(), 0
    with Console(config.quiet, len(clips), "extract") as console:
        for number, path in enumerate(clips):
            video = open_video(path, config.selection)
            show = _stage_of(console, path.name)
            found = extraction.extract(video, encoder, store, config.store_dtype, show)
            console.done(number)
            console.result(_summary(video, found.features.values.shape, found.cached))
            frames += len(video.frames)
        store.write_index()
        seconds = time.perf_counter() - started
        console.result(
            f"{len(clips)} clips, {frames} frames in {seconds:.1f} s: "
            f"{len(clips) / seconds:.3g} clips/s, {frames / seconds:.3g} frames/s, "
            f"hit rate {store.hit_rate:.0%}; store {config.out}"
        )


def _stage_of(console: Console, name: str) -> Progress:
    return lambda step, steps, _: console.stage((name, step, steps))


def _summary(video: Video, shape: tuple[int, ...], cached: bool) -> str:
    _, t, c, h, w = shape
    state = "in store" if cached else "extracted"
    first = f"{video.path}: {state}, {t} frames of {c} channels on a {h} x {w} grid"
    return "\n".join([first, *(f"{video.path}: note: {note}" for note in video.notes)])
