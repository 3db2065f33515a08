"""Frozen encoders: which, which layer, how many pixels, frames and cells; how well it says where.

What is measured against is the truth of rendered clips, read by a linear map of single cells: the
same for all, and fitted in closed form.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from encoders.features import FeatureMap
from encoders.frozen import load_encoder
from encoders.identity import IdentifiedEncoder
from encoders.release import WeightsMissing
from vidphys.data.clips import Clips
from vidphys.trade.context import Context
from vidphys.trade.measure import Job, Scale
from vidphys.trade.scenery import Probe, coloured_clips, encoded, multiply_adds

SCALE = Scale(
    "encoders",
    "ms_per_frame",
    1e3,
    "probe_nmse",
    "true positions of three coloured disks, by a linear map of single cells, on held-out clips",
)
POOLINGS = (1, 2)
# encoder -> the options that are tried together; each is loaded where its weights are
CHOICES: dict[str, list[dict[str, Any]]] = {
    "dino-tiny": [{}, {"layer": 2}, {"resolution": 32}, {"frame_stride": 2}],
    "videomae-tiny": [{}, {"layer": 2}, {"frame_stride": 2}],
    "vjepa2-tiny": [{}, {"layer": 2}, {"resolution": 32}, {"frame_stride": 2}],
    "hiera": [
        {"layer": layer, "resolution": resolution}
        for layer, resolution in ((4, 64), (8, 64), (8, 128))
    ],
    "i3d": [{"layer": "Mixed_3c"}, {"layer": "Mixed_4f"}],
    "dinov2-small": [{"layer": 6, "resolution": 112}, {"layer": 12, "resolution": 112}],
}


def jobs(context: Context) -> Iterator[Job]:
    """Each encoder whose weights are here, under each choice and pooling."""
    clips = coloured_clips(context)
    for name, options in available(context).items():
        for chosen in options:
            encoder = load_encoder(name, chosen, context.weights, context.device)
            features = encoded(encoder, clips)
            for pooling in POOLINGS:
                if pooling == 1 or min(features.grid) >= 2 * pooling:
                    yield _Look(clips, name, chosen, encoder, features).job(pooling)


def available(context: Context) -> dict[str, list[dict[str, Any]]]:
    """The choices whose weights are on this machine; the others are noted as skipped."""
    found = {}
    asked: dict[str, list[dict[str, Any]]] = {name: [{}] for name in context.encoders}
    for name, options in (asked | CHOICES).items():
        try:
            load_encoder(name, {}, context.weights, context.device)
            found[name] = options
        except WeightsMissing as error:
            context.skip(f"encoders/{name}", str(error))
    return found


@dataclass(frozen=True)
class _Look:
    clips: Clips
    name: str
    chosen: dict[str, Any]
    encoder: IdentifiedEncoder
    features: FeatureMap

    def job(self, pooling: int) -> Job:
        clips, encoder = self.clips, self.encoder
        probe = Probe(clips, pooling)
        frames = clips.frames[:1]

        def work() -> Tensor:
            return encoder(frames, clips.times).values

        _, t, _, h, w = self.features.values.shape
        return Job(
            task="positions of three coloured disks",
            configuration={
                "encoder": self.name,
                **self.chosen,
                "dtype": "float32",
                "pooling": pooling,
            },
            work=work,
            errors=lambda _: {"probe_nmse": probe.nmse(self.features)},
            per_call=frames.shape[1],
            dtype="float32",
            units={
                "multiply_adds": multiply_adds(work) / frames.shape[1],
                "tokens": t * (h // pooling) * (w // pooling) / frames.shape[1],
            },
        )
