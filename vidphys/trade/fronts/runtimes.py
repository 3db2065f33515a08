"""What computes a frozen network: runtime, precision, frames a pass, or the store on disk.

The error is against the same network in float32 under torch. What the store keeps in fewer cells
counts as the mean of a block in each of its cells. Of what it gives back it is also told how well
positions are read from it, by the probe of the encoders' front.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from encoders.arrays import bytes_kept
from encoders.features import FeatureMap
from encoders.frozen import load_encoder, options_of
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore
from vidphys.data.clips import Clips
from vidphys.data.extraction import StoredDtype
from vidphys.points.point import Setting
from vidphys.trade.context import Context
from vidphys.trade.fronts.encoders import available
from vidphys.trade.measure import Job, Scale
from vidphys.trade.scenery import Probe, coloured_clips, encoded

SCALE = Scale(
    "runtimes",
    "ms_per_encoding",
    1e3,
    "feature_error",
    "the same network in float32 under torch; |x - x'| / |x'| over all features",
)
FEWER = 4  # cells on a side
STORED: tuple[tuple[StoredDtype, int | None], ...] = (  # and the cells on a side at most
    ("float32", None),
    ("float16", None),
    ("bfloat16", None),
    ("int8", None),
    ("float16", FEWER),
    ("int8", FEWER),
)
BATCHES = (1, 8)


def jobs(context: Context) -> Iterator[Job]:
    """Each encoder that is here: what it can be computed by, and what the store gives back."""
    clips = coloured_clips(context)
    for name in available(context):
        case = _Case(context, clips, name, *_reference(context, clips, name))
        for runtime, dtype in runtimes_of(name, context):
            for batch in BATCHES if "batch" in options_of(name) else (None,):
                yield case.computed(runtime, dtype, batch)
        for stored, grid in STORED:
            if grid is None or max(case.whole.grid) > grid:
                yield case.cached(stored, grid)


def runtimes_of(name: str, context: Context) -> Iterator[tuple[str, str]]:
    """(runtime, dtype) pairs that an encoder can be computed by on this machine."""
    taken = options_of(name)
    yield "torch", "float32"
    if "dtype" in taken:
        yield "torch", "bfloat16"
    if "runtime" not in taken:
        return
    for runtime in context.sizes.runtimes:
        if runtime == "openvino" and importlib.util.find_spec("openvino") is None:
            context.skip("runtimes/openvino", "not installed; pip install 'vidphys[openvino]'")
        elif runtime != "openvino" or context.device == "cpu":
            yield from ((runtime, "float32"), (runtime, "bfloat16"))


def _reference(context: Context, clips: Clips, name: str) -> tuple[EncoderIdentity, FeatureMap]:
    encoder = load_encoder(name, {}, context.weights, context.device)
    return encoder.identity, encoded(encoder, clips)


@dataclass(frozen=True)
class _Case:
    context: Context
    clips: Clips
    name: str
    identity: EncoderIdentity
    whole: FeatureMap  # of all clips

    @property
    def truth(self) -> Tensor:
        """Of the clip that is timed."""
        return self.whole.values[:1]

    def computed(self, runtime: str, dtype: str, batch: int | None) -> Job:
        told = {"dtype": dtype, "batch": batch, "runtime": None if runtime == "torch" else runtime}
        taken = options_of(self.name)
        options: dict[str, Setting] = {
            k: v for k, v in told.items() if k in taken and v is not None
        }
        encoder = load_encoder(self.name, options, self.context.weights, self.context.device)
        one = self.clips.first(1)
        task = f"features of {self.name}"
        size = bytes_kept(self.truth.shape, dtype)
        return self._job(task, options, dtype, lambda: encoded(encoder, one).values, size)

    def cached(self, stored: StoredDtype, grid: int | None) -> Job:
        """The store's answer, every value touched."""
        store = FeatureStore(self.context.scratch / "features")
        size = self.clips.frames.shape[-2], self.clips.frames.shape[-1]
        requests = [
            FeatureRequest(
                encoder=self.identity,
                source_sha256=f"{number:064d}",
                frames=tuple(range(self.clips.frames.shape[1])),
                times=tuple(self.clips.times.tolist()),
                frame_size=size,
                dtype=stored,
                grid=grid,
            )
            for number in range(len(self.clips))
        ]
        for request, values in zip(requests, self.whole.values, strict=True):
            one = replace(self.whole, values=values.unsqueeze(0))
            store.get(request, "clip", lambda one=one: one)  # type: ignore[misc]

        def read(request: FeatureRequest) -> FeatureMap:
            found = store.read(request)
            assert found is not None
            return replace(found, values=found.values.float())

        def look() -> Tensor:
            return read(requests[0]).values

        def reads() -> dict[str, float]:
            first, *_ = maps = [read(request) for request in requests]
            kept = replace(first, values=torch.cat([each.values for each in maps]))
            return {"probe_nmse": Probe(self.clips).nmse(kept)}

        options: dict[str, Setting] = {"store_dtype": stored}
        if grid is not None:
            options["grid"] = grid
        task = f"features of {self.name}, from the store"
        kept = bytes_kept(read(requests[0]).values.shape, stored)
        return self._job(task, options, stored, look, kept, reads)

    def _job(
        self,
        task: str,
        options: dict[str, Setting],
        dtype: str,
        work: Callable[[], Tensor],
        size: float,
        more: Callable[[], dict[str, float]] = dict,
    ) -> Job:
        def errors(values: Tensor) -> dict[str, float]:
            there = _spread(values, self.truth).double()
            away = (there - self.truth.double()).norm()
            return {"feature_error": float(away / self.truth.double().norm()), **more()}

        return Job(
            task=task,
            configuration={"encoder": self.name, **options},
            work=work,
            errors=errors,
            per_call=self.clips.frames.shape[1],
            dtype=dtype,
            units={"bytes": size / self.clips.frames.shape[1]},
        )


def _spread(values: Tensor, like: Tensor) -> Tensor:
    """Maps ``(b, t, c, h, w)`` with as many cells as others: the nearest of theirs in each."""
    if values.shape == like.shape:
        return values
    cells = like.shape[-2:]
    return interpolate(values.flatten(0, 1), cells, mode="nearest").unflatten(0, values.shape[:2])
