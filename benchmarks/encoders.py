"""Benchmark rows of frozen encoders: the fastest runtime that holds the error, and the store.

Networks have fresh weights: speed does not depend on them, and the error is that of the arithmetic.
The peer is the library's model in float32 on pixels that are ready; ours also prepares them.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.match import Contender, Match
from encoders.features import FeatureMap
from encoders.frozen import DINOv2Encoder, DINOv2Settings, VideoMAEEncoder, VideoMAESettings
from encoders.frozen.runtimes import Runtime
from encoders.release import WeightsFile
from encoders.store import FeatureRequest, FeatureStore

IMAGE, FRAMES = 224, {"dinov2-small": 4, "videomae-base": 16}
FASTER, CACHED, WORST = 2.5, 100.0, 1e-2  # bars: ratios of speed, and a feature error
LAYERS = 6.0  # the same of all twelve layers by one pass
FRESH = WeightsFile(Path("fresh weights"), "0" * 64)


Build = Callable[[str, Runtime], tuple[Any, Callable[[Tensor], Tensor]]]


def _computed(name: str, build: Build) -> Match:
    """Frames a second by the fastest runtime that is here."""
    runtime: Runtime = "openvino" if importlib.util.find_spec("openvino") else "torch"
    frames, times = _clip(name)
    encoder, _ = build("bfloat16", runtime)
    exact, shipped = build("float32", "torch")
    away = encoder(frames, times).values - (truth := exact(frames, times).values)
    error = float(away.norm() / truth.norm())
    path = f"{runtime} bfloat16, feature error {error:.1e}"
    if error > WORST:
        path += f" (over the {WORST:g} that counts)"
    what = "features in bfloat16, pixels resized and normalised before"
    ours = Contender(lambda: encoder(frames, times), FRAMES[name], path, what, "loading, compiling")
    against = {
        "float32 as shipped": (_shipped(name, shipped, torch.float32), FASTER),
        "bfloat16, the same model": (_shipped(name, shipped, torch.bfloat16), 1.0),
    }
    return Match(name, "frames", ours, against, {"feature error": error})


def _from_store(name: str, build: Build) -> Match:
    """The same from the store."""
    encoder, shipped = build("float32", "torch")
    frames, times = _clip(name)
    store = FeatureStore(Path(tempfile.mkdtemp(prefix="vidphys-benchmark-")))
    request = FeatureRequest(
        encoder.identity, "0" * 64, tuple(range(len(times))), tuple(times.tolist()), (IMAGE, IMAGE)
    )
    store.get(request, "clip", lambda: encoder(frames, times))

    def read() -> Tensor:
        found: FeatureMap | None = store.read(request)
        assert found is not None
        return found.values.float()

    what = "features read back and made float32"
    ours = Contender(read, FRAMES[name], "store on disk, float16", what, "the extraction before")
    peer = {"float32 as shipped": (_shipped(name, shipped, torch.float32), CACHED)}
    return Match(f"{name}, cached", "frames", ours, peer)


def _clip(name: str) -> tuple[Tensor, Tensor]:
    rng = torch.Generator().manual_seed(0)
    frames = torch.rand(1, FRAMES[name], 3, IMAGE, IMAGE, generator=rng)
    return frames, torch.arange(FRAMES[name], dtype=torch.float64)


def _shipped(name: str, network: Callable[[Tensor], Tensor], dtype: torch.dtype) -> Contender:
    """The library's model as it is, or with torch's own casts to a shorter type."""
    pixels = _clip(name)[0]
    shorter = dtype != torch.float32

    def work() -> Tensor:
        with torch.inference_mode(), torch.autocast("cpu", dtype, enabled=shorter):
            return network(pixels)

    what = f"features in {str(dtype).removeprefix('torch.')} of pixels that are ready"
    return Contender(work, FRAMES[name], "torch", what, "preparing pixels")


def dinov2_small(settings: DINOv2Settings) -> DINOv2Encoder:
    """Ours, whose blocks count for as much as in a trained one: timm begins at a scale of 1e-5."""
    import timm

    torch.manual_seed(0)
    network = timm.create_model(
        "vit_small_patch14_dinov2",
        pretrained=False,
        num_classes=0,
        dynamic_img_size=True,
        init_values=1.0,
    )
    return DINOv2Encoder(network, settings, "dinov2-small", FRESH)


def _dinov2(dtype: Any, runtime: Runtime) -> tuple[Any, Callable[[Tensor], Tensor]]:
    settings = DINOv2Settings(dtype=dtype, batch=FRAMES["dinov2-small"], runtime=runtime)
    encoder = dinov2_small(settings)
    network: Any = encoder.network
    return encoder, lambda pixels: network.forward_features(pixels[0])


def _videomae(dtype: Any, runtime: Runtime) -> tuple[Any, Callable[[Tensor], Tensor]]:
    from transformers import VideoMAEConfig, VideoMAEModel

    torch.manual_seed(0)
    network = VideoMAEModel(VideoMAEConfig())
    settings = VideoMAESettings(dtype=dtype, runtime=runtime)
    encoder = VideoMAEEncoder(network, settings, "videomae-base", FRESH)
    return encoder, lambda pixels: network(pixels).last_hidden_state


def all_layers() -> Match:
    """Twelve layers by one pass, beside a pass a layer that stops where the layer is read."""
    encoder, _ = _dinov2("float32", "torch")
    frames, times = _clip("dinov2-small")

    def each() -> list[Tensor]:
        return [encoder.at(layer)(frames, times).values for layer in encoder.layers]

    def together() -> list[Tensor]:
        found = encoder.encode_layers(frames, times, encoder.layers)
        return [features.values for features in found.values()]

    away = max(float((a - b).abs().max()) for a, b in zip(each(), together(), strict=True))
    what, per_call = f"features of {len(encoder.layers)} layers in float32", FRAMES["dinov2-small"]
    ours = Contender(together, per_call, "torch, one pass", what, "loading")
    peer = Contender(each, per_call, "torch, a pass a layer", what, "loading")
    return Match(
        "all layers", "frames", ours, {"a pass a layer": (peer, LAYERS)}, {"difference": away}
    )


dinov2 = partial(_computed, "dinov2-small", _dinov2)
dinov2_cached = partial(_from_store, "dinov2-small", _dinov2)
videomae = partial(_computed, "videomae-base", _videomae)
videomae_cached = partial(_from_store, "videomae-base", _videomae)
