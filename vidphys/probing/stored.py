"""The examples of a whole data set in a feature store: an entry for each layer and view."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import torch

from encoders.features import FeatureMap
from encoders.identity import LayeredEncoder
from encoders.store import DTYPES, FeatureRequest, FeatureStore
from vidphys.probing.examples import View
from vidphys.probing.layers import Frozen, Maps
from vidphys.probing.shown import Shown
from vidphys.progress import Progress

DTYPE: Literal["float16"] = "float16"


@dataclass(frozen=True)
class StoredExamples:
    """Reads and writes the maps of examples, ``(e, c, h, w)`` by layer.

    Args:
        store: where they are kept.
        shown: the clips.
        prints: of the clips, and of the frames that are shown.
        grid: cells on a side that maps are pooled to at most.
    """

    store: FeatureStore
    shown: Shown
    prints: tuple[str, ...]
    grid: int

    def maps(self, seen: Frozen, name: str, view: View, progress: Progress | None = None) -> Maps:
        """The layers under one view, memory-mapped; encoded in one pass where one is not stored.

        Args:
            seen: a frozen encoder and its layers that are read.
            name: of the view.
            view: how examples are made of clips.
            progress: called as ``(clips done, clips, 0.0)``.
        """
        requests = {layer: self._request(seen.encoder, layer, name) for layer in seen.layers}
        if not all(map(self.store.has, requests.values())):
            made = self._made(seen, view, progress)
            for layer, request in requests.items():
                values = made.pop(layer)
                stamps = torch.arange(len(values), dtype=torch.float64)
                features = FeatureMap(values[None], (1.0, 1.0), stamps)
                self.store.write(request, "examples of probes", features)
        found = {layer: self.store.read(request) for layer, request in requests.items()}
        return {layer: features.values[0] for layer, features in found.items() if features}

    def _made(self, seen: Frozen, view: View, progress: Progress | None) -> Maps:
        parts: dict[str, list[torch.Tensor]] = {layer: [] for layer in seen.layers}
        done = 0
        for block in self.shown.blocks():
            maps = view(seen, block.frames, block.times, block.read, self.grid)
            for layer, values in maps.items():
                parts[layer].append(values.to(DTYPES[DTYPE]))
            done += len(block.frames)
            if progress is not None:
                progress(done, self.shown.count, 0.0)
        return {layer: torch.cat(some) for layer, some in parts.items()}

    @cached_property
    def _first(self) -> tuple[tuple[int, ...], tuple[int, int]]:
        """The frames that are read of the first clip, and its (height, width)."""
        block = next(iter(self.shown.blocks()))
        return block.read, (block.frames.shape[-2], block.frames.shape[-1])

    def _request(self, encoder: LayeredEncoder, layer: str, name: str) -> FeatureRequest:
        read, size = self._first
        examples = range(self.shown.count * self.shown.each)
        words = f"{layer}, {name}, frames {read}, at most {self.grid} cells on a side"
        return FeatureRequest(
            encoder=replace(encoder.at(layer).identity, layer=words),
            source_sha256=hashlib.sha256(" ".join(self.prints).encode()).hexdigest(),
            frames=tuple(examples),
            times=tuple(float(number) for number in examples),
            frame_size=size,
            dtype=DTYPE,
        )
