"""Benchmark row of extraction: clips on disk to features on disk, beside the loop one would write.

The network is DINOv2-S with fresh weights: speed does not depend on them. The loop decodes a clip,
prepares its frames, calls the library's model on them in float32, one by one or as many as eight at
a time, and saves what comes. Decoding is a small part of either; ours does it in a process of its
own, which the clock of this one does not see.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.encoders import dinov2_small
from benchmarks.match import Contender, Match
from encoders.frozen import DINOv2Settings, FrozenEncoder
from encoders.frozen.runtimes import Runtime
from encoders.preprocess import IMAGENET_MEAN, IMAGENET_STD
from encoders.store import FeatureStore
from vidphys.data.ahead import ahead
from vidphys.data.many import Wanted, extract_many
from vidphys.data.video import ClipSelection, Video, open_video

CLIPS, FRAMES, SIZE, BATCH = 4, 16, (240, 320), 8
FASTER = 2.5  # bar


def extraction() -> Match:
    """Four short clips through DINOv2-S, into a store."""
    folder = Path(tempfile.mkdtemp(prefix="vidphys-benchmark-"))
    files = [write_clip(folder / f"{number}.avi", number) for number in range(CLIPS)]
    runtime: Runtime = "openvino" if importlib.util.find_spec("openvino") else "torch"
    fast = dinov2_small(DINOv2Settings(batch=BATCH, dtype="bfloat16", runtime=runtime))
    exact = dinov2_small(DINOv2Settings())
    network: Any = exact.network
    runs: list[float] = []

    def ours() -> None:
        store = FeatureStore(Path(tempfile.mkdtemp(dir=folder)))
        wanted = Wanted(fast, (fast.identity.layer,), store)
        begun = time.perf_counter()
        busy = extract_many(ahead([opener(file) for file in files]), wanted, lambda *_: None)
        runs.append(busy / (time.perf_counter() - begun))

    ours()
    away = _away(fast, exact, files[0])
    path = f"{runtime} bfloat16, feature error {away:.1e}, encoder busy {runs[-1]:.0%}"
    mine = Contender(ours, CLIPS * FRAMES, path, "features in a store, from files", "loading")
    peers = {
        name: (_loop(partial(plain_loop, files, network, together)), FASTER)
        for name, together in (("a frame a call", 1), ("eight frames a call", BATCH))
    }
    numbers = {"feature error": away, "encoder busy": runs[-1]}
    return Match("extraction", "frames", mine, peers, numbers)


def plain_loop(files: Sequence[Path], network: Any, together: int) -> None:
    """What one would write: so many frames a call, and an array beside each clip."""
    import cv2

    for file in files:
        reader, kept = cv2.VideoCapture(str(file)), []
        while (read := reader.read())[0]:
            kept.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
        frames = torch.from_numpy(np.stack(kept)).permute(0, 3, 1, 2)
        found = [_features(network, some) for some in frames.split(together)]
        np.save(file.with_suffix(".npy"), torch.cat(found).half().numpy())


def _loop(work: Callable[[], None]) -> Contender:
    what = "features in .npy files, from files"
    return Contender(work, CLIPS * FRAMES, "timm float32", what, "loading")


def write_clip(path: Path, seed: int) -> Path:
    """A short clip of coarse noise."""
    import cv2

    rng = np.random.default_rng(seed)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, SIZE[::-1])
    for _ in range(FRAMES):
        coarse = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
        writer.write(cv2.resize(coarse, SIZE[::-1]))
    writer.release()
    return path


def opener(path: Path) -> Callable[[], Video]:
    """What opens a clip, later."""
    return lambda: open_video(path, ClipSelection())


def _features(network: Any, frames: Tensor) -> Tensor:
    """As the plain loop makes them: the picture resized as ours is, and the last layer's tokens."""
    mean, std = (torch.tensor(x)[:, None, None] for x in (IMAGENET_MEAN, IMAGENET_STD))
    with torch.inference_mode():
        sized = torch.nn.functional.interpolate(
            frames.float() / 255, (168, 224), mode="bilinear", antialias=True
        )
        return network.forward_features((sized - mean) / std)[:, 1:]


def _away(fast: FrozenEncoder, exact: FrozenEncoder, file: Path) -> float:
    video: Video = open_video(file, ClipSelection(stop=2))
    frames = torch.from_numpy(np.asarray(video.frames)).permute(0, 3, 1, 2)[None]
    a, b = (each(frames, torch.from_numpy(video.times)).values for each in (fast, exact))
    return float((a - b).norm() / b.norm())
