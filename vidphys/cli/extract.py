"""``vidphys extract``: features of clips by a frozen encoder, into a store."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from vidphys.cli.console import Console
from vidphys.cli.profiles import with_profile
from vidphys.cli.seeing import SeeingOptions
from vidphys.data.listed import listed_clips
from vidphys.data.video import Video, open_video
from vidphys.devices import prepare_device
from vidphys.errors import InputError

if TYPE_CHECKING:
    from encoders.identity import LayeredEncoder
    from encoders.store import FeatureStore
    from vidphys.data.many import Wanted
    from vidphys.data.precision import Precision

ALL = ("all",)  # layers
LOST = "feature_error"  # in an entry's manifest
PACKED = 1000  # entries of their own, from which on a store is packed


@dataclass(frozen=True)
class ExtractConfig(SeeingOptions):
    """Encode clips with a frozen encoder; what the store holds already is not encoded again.

    Example: vidphys extract clip.mp4 --out features --weights weights --layer 8

    Args:
        clips: video files, folders of them, patterns such as 'clips/*.mp4', .txt files that name a
            clip a line, data sets (of LeRobot, Hugging Face, WebDataset, HDF5, NPZ), or clips of
            one, named as if it were a folder (runs.h5/trial).
        out: folder of the feature store; made if it is not there.
        layers: what is read, several in one pass, or all: hiera 4, 8, 16 or 32 (stride in network
            pixels); i3d a stage, such as Mixed_4f; the transformers a number of blocks.
        resample: take the frames nearest to so many a second, of clips whose frames come unevenly.
        fast: compute in bfloat16 where that is faster here; its error is told, and recorded.
        batch: frames, or windows of a video encoder, per forward pass.
        runtime: what computes the network, for encoders that have a choice.
        store_dtype: of the values on disk; int8 has 8 bits a cell, and each channel's mean over
            cells as it is. What was lost stands in each entry's manifest.
        grid: cells on a side that maps are pooled to at most before they are stored; such entries
            are others than those of whole maps.
        shared: share the work with all who run the same command on the same folders, on this
            machine or others that see them; each may come, leave or die at any time.
        lease: with shared: seconds without a sign of life after which a worker's clips are taken
            over by another.
        profile: settings for this verb, from a file that `vidphys trade --pick ... --save` wrote.
        quiet: show no progress.
    """

    clips: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Path
    layers: Annotated[tuple[int | str, ...], tyro.conf.arg(aliases=("--layer",))] = ()
    resample: float | None = None
    fast: bool = False
    batch: int | None = None
    runtime: Literal["torch", "compile", "openvino"] | None = None
    store_dtype: Literal["float16", "bfloat16", "float32", "int8"] = "float16"
    grid: int | None = None
    shared: bool = False
    lease: float | None = None
    profile: Path | None = None
    quiet: bool = False

    @property
    def encoder_options(self) -> dict[str, Any]:
        """Those of the encoder, and how it computes."""
        how = {"batch": self.batch, "runtime": self.runtime}
        return {**super().encoder_options, **how}


def extract(config: ExtractConfig) -> int:
    """Extract the features of every clip and say how fast and how many were there already.

    Returns 1 where work was shared and a clip could not be taken, else 0.

    Raises:
        InputError: no clip, a clip that cannot be read, weights that are missing or wrong, a
            device that is not there, or a damaged store entry.
    """
    config = with_profile(config, "extract")
    if not config.clips:
        raise InputError("extract: no clips; name at least one video file")
    if config.fast and config.dtype is not None:
        raise InputError("extract: --dtype is given, and --fast chooses it; leave one of them out")
    if config.fast and config.shared:
        raise InputError("extract: --fast measures this machine; with --shared say --dtype")
    if config.grid is not None and config.grid < 1:
        raise InputError(f"extract: --grid {config.grid}; maps need at least 1 cell on a side")
    if config.lease is not None and not config.shared:
        raise InputError("extract: --lease is of work that is shared; add --shared")
    try:
        if config.shared:
            return _take_part(config, *frozen_encoder(config))
        _extract_all(config, listed_clips(config.clips), *frozen_encoder(config))
    except ValueError as error:
        raise InputError(str(error)) from error
    return 0


def frozen_encoder(config: ExtractConfig) -> tuple[LayeredEncoder, tuple[str, ...]]:
    """The encoder that a configuration names, and the layers that are read.

    Raises:
        InputError: a device that is not there.
        ValueError: an unknown encoder, an option or a layer that it does not take, or weights that
            are missing or wrong.
    """
    from encoders.frozen import load_encoder

    prepare_device(config.device)
    encoder = load_encoder(config.encoder, _options(config), config.weights, config.device)
    if config.layers == ALL:
        return encoder, encoder.layers
    layers = config.layers or (encoder.identity.layer,)
    return encoder, tuple(encoder.at(layer).identity.layer for layer in layers)


def _extract_all(
    config: ExtractConfig, files: list[Path], encoder: LayeredEncoder, layers: tuple[str, ...]
) -> None:
    from encoders.store import FeatureStore
    from vidphys.data.ahead import ahead
    from vidphys.data.many import Wanted, extract_many

    store, known = FeatureStore(config.out), dict[str, float]()
    if config.fast:
        found = _fast(config, files[0], layers)
        encoder = found.encoder
        if found.short:
            known[LOST] = found.error
        print(found)
    wanted = Wanted(encoder, layers, store, config.store_dtype, config.grid, known)
    started, counts = time.perf_counter(), Counter[str]()
    with Console(config.quiet, len(files), "extract") as console:

        def done(video: Video, made: Sequence[str]) -> None:
            console.done(counts["clips"])
            counts.update(
                clips=1,
                frames=len(video.frames),
                made=len(made),
            )
            for line in _summary(video, wanted, store, made):
                console.result(line)

        def opened() -> Iterator[Video]:
            first = True
            for video in ahead([partial(_open, config, path) for path in files]):
                if first:
                    _tell_cost(console, wanted, video, files)
                first = False
                if _in_fewer_bits(config) and not known and wanted.missing(video):
                    known.update(_lost(config, console, encoder, layers, video))
                yield video

        busy = extract_many(opened(), wanted, done)
        store.pack(PACKED)
        seconds = time.perf_counter() - started
        total = counts["clips"] * len(layers)
        share = f", encoder busy {busy / seconds:.0%}" if busy else ""
        console.result(
            f"{counts['clips']} clips, {counts['frames']} frames in {seconds:.1f} s: "
            f"{counts['clips'] / seconds:.3g} clips/s, {counts['frames'] / seconds:.3g} frames/s, "
            f"hit rate {1 - counts['made'] / total:.0%}{share}; store {config.out}"
        )


def _take_part(config: ExtractConfig, encoder: LayeredEncoder, layers: tuple[str, ...]) -> int:
    from encoders.store import FeatureStore
    from vidphys.data.many import Wanted
    from vidphys.data.shared import Extraction
    from vidphys.runs.claims import LEASE

    store, begun = FeatureStore(config.out), time.perf_counter()
    known: dict[str, float] = {}
    wanted = Wanted(encoder, layers, store, config.store_dtype, config.grid, known)
    selection = {**asdict(config.selection), "resample": config.resample}
    work = Extraction(store, config.clips, wanted, selection)
    with Console(config.quiet, len(work.units), "extract") as console:
        if _in_fewer_bits(config) and not work.joined:
            first = work.first(partial(_open, config))
            known.update(_lost(config, console, encoder, layers, first) if first else {})
        found = work.run(
            partial(_open, config), console.done, LEASE if config.lease is None else config.lease
        )
        for clip, why in found.failed:
            console.result(f"{clip}: left out: {why}")
        console.result(
            f"{found.clips} clips in {found.units} units, {found.here} of them by this worker in "
            f"{time.perf_counter() - begun:.1f} s: {found.entries} entries are new, "
            f"{len(found.failed)} clips were left out; store {config.out}"
        )
    return 1 if found.failed else 0


def _in_fewer_bits(config: ExtractConfig) -> bool:
    return config.dtype not in (None, "float32")


def _lost(
    config: ExtractConfig,
    console: Console,
    encoder: LayeredEncoder,
    layers: tuple[str, ...],
    video: Video,
) -> dict[str, float]:
    """What manifests are to say of an encoder that computes in fewer bits; it is told too."""
    from vidphys.data import precision

    error = precision.error_of(encoder, _loading(config), layers, video)
    console.result(f"{config.dtype}: a feature error of {error:.2g} against float32")
    return {LOST: error}


def _fast(config: ExtractConfig, file: Path, layers: tuple[str, ...]) -> Precision:
    from vidphys.data.precision import faster

    return faster(_loading(config), layers, _open(config, file))


def _loading(config: ExtractConfig) -> Callable[[str], LayeredEncoder]:
    """The encoder in any precision."""
    from encoders.frozen import load_encoder

    options, where = _options(config), (config.weights, config.device)
    return lambda dtype: load_encoder(config.encoder, {**options, "dtype": dtype}, *where)


def _options(config: ExtractConfig) -> dict[str, Any]:
    """What the encoder is made by; it is made for the first layer, where some are named."""
    named = config.layers and config.layers != ALL
    return {**config.encoder_options, "layer": config.layers[0] if named else None}


def _open(config: ExtractConfig, path: Path) -> Video:
    from vidphys.data.resampling import in_step

    video = open_video(path, config.selection)
    return in_step(video, config.resample, config.stride * (config.frame_stride or 1))


def _tell_cost(console: Console, wanted: Wanted, first: Video, files: list[Path]) -> None:
    """Say what the run will take, if it is more than a clip: as the first clip is, so are all."""
    from vidphys.data.many import cost_of

    if len(files) < 2:
        return
    cost = cost_of(wanted, first.size)
    frames = float(len(first.frames) * len(files))
    if all(path.is_file() for path in files):
        frames = len(first.frames) * sum(path.stat().st_size for path in files)
        frames /= max(1, first.path.stat().st_size)
    layers = "1 layer takes" if len(wanted.layers) == 1 else f"{len(wanted.layers)} layers take"
    console.result(
        f"{len(files)} clips, about {frames:.2g} frames: {layers} about "
        f"{frames * cost.seconds / 60:.2g} min and {frames * cost.bytes / 2**20:.2g} MiB, less "
        "what is in the store already"
    )


def _summary(
    video: Video, wanted: Wanted, store: FeatureStore, made: Sequence[str]
) -> Iterator[str]:
    for layer, request in wanted.requests(video).items():
        found = store.shape_of(request)
        state = "extracted" if layer in made else "in store"
        of = f", layer {layer}" if len(wanted.layers) > 1 else ""
        t, c, h, w = found
        yield f"{video.path}: {state}{of}, {t} frames of {c} channels on a {h} x {w} grid"
    yield from (f"{video.path}: note: {note}" for note in video.notes)
