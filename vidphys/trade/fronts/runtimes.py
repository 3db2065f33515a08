"""What computes a frozen network: runtime, precision, frames a pass, or the store on disk.

The error is against the same network in float32 under torch.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from encoders.frozen import load_encoder, options_of
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore
from vidphys.data.clips import Clips
from vidphys.points.point import Setting
from vidphys.trade.context import Context
from vidphys.trade.fronts.encoders import available
from vidphys.trade.measure import Job, Scale
from vidphys.trade.scenery import coloured_clips, encoded

SCALE = Scale(
    "runtimes",
    "ms_per_encoding",
    1e3,
    "feature_error",
    "the same network in float32 under torch; |x - x'| / |x'| over all features",
)
STORED: tuple[Literal["float32", "float16", "bfloat16"], ...] = ("float32", "float16", "bfloat16")
BATCHES = (1, 8)


def jobs(context: Context) -> Iterator[Job]:
    """Each encoder that is here: runtimes that it has, and what the store gives back."""
    clips = coloured_clips(context)
    for name in available(context):
        case = _Case(context, clips, name, *_reference(context, clips, name))
        for runtime, dtype in runtimes_of(name, context):
            for batch in BATCHES:
                yield case.computed(runtime, dtype, batch)
        for stored in STORED:
            yield case.cached(stored)


def runtimes_of(name: str, context: Context) -> Iterator[tuple[str, str]]:
    """(runtime, dtype) pairs that an encoder can be computed by on this machine."""
    yield from (("torch", "float32"), ("torch", "bfloat16"))
    if "runtime" not in options_of(name):
        return
    for runtime in context.sizes.runtimes:
        if runtime == "openvino" and importlib.util.find_spec("openvino") is None:
            context.skip("runtimes/openvino", "not installed; pip install 'vidphys[openvino]'")
        elif runtime != "openvino" or context.device == "cpu":
            yield from ((runtime, "float32"), (runtime, "bfloat16"))


def _reference(context: Context, clips: Clips, name: str) -> tuple[EncoderIdentity, Tensor]:
    encoder = load_encoder(name, {}, context.weights, context.device)
    return encoder.identity, encoded(encoder, clips.first(1)).values


@dataclass(frozen=True)
class _Case:
    context: Context
    clips: Clips
    name: str
    identity: EncoderIdentity
    truth: Tensor

    def computed(self, runtime: str, dtype: str, batch: int) -> Job:
        options: dict[str, Setting] = {"dtype": dtype, "batch": batch}
        if runtime != "torch":
            options["runtime"] = runtime
        encoder = load_encoder(self.name, options, self.context.weights, self.context.device)
        one = self.clips.first(1)
        task = f"features of {self.name}"
        return self._job(task, options, dtype, lambda: encoded(encoder, one).values)

    def cached(self, stored: Literal["float32", "float16", "bfloat16"]) -> Job:
        """The store's answer, every value touched."""
        store = FeatureStore(self.context.scratch / "features")
        one = self.clips.first(1)
        request = FeatureRequest(
            encoder=self.identity,
            source_sha256="0" * 64,
            frames=tuple(range(one.frames.shape[1])),
            times=tuple(one.times.tolist()),
            frame_size=(one.frames.shape[-2], one.frames.shape[-1]),
            dtype=stored,
        )
        encoder = load_encoder(self.name, {}, self.context.weights, self.context.device)
        store.get(request, "clip", lambda: encoded(encoder, one))

        def read() -> Tensor:
            found = store.read(request)
            assert found is not None
            return found.values.float()

        task = f"features of {self.name}, from the store"
        return self._job(task, {"store_dtype": stored}, stored, read)

    def _job(
        self, task: str, options: dict[str, Setting], dtype: str, work: Callable[[], Tensor]
    ) -> Job:
        def errors(values: Tensor) -> dict[str, float]:
            away = (values.double() - self.truth.double()).norm()
            return {"feature_error": float(away / self.truth.double().norm())}

        size = torch.finfo(getattr(torch, dtype)).bits / 8
        return Job(
            task=task,
            configuration={"encoder": self.name, **options},
            work=work,
            errors=errors,
            per_call=self.clips.frames.shape[1],
            dtype=dtype,
            units={"bytes": size * self.truth.numel() / self.clips.frames.shape[1]},
        )
