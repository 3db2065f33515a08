"""Which encoder made a feature, exactly: what a feature store files it under."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from torch import Tensor

    from encoders.features import FeatureMap, FeatureStream


@dataclass(frozen=True)
class EncoderIdentity:
    """Everything about an encoder that its features depend on.

    Args:
        name: the adapter.
        code_version: of the adapter; raised whenever its output changes.
        weights_sha256: hash of the file that it was loaded from.
        preprocessing: how frames became the network's input, in words.
        layer: what is read.
        resolution: pixels of the longer side of the network's input.
        dtype: of the computation.
    """

    name: str
    code_version: int
    weights_sha256: str
    preprocessing: str
    layer: str
    resolution: int
    dtype: str


@runtime_checkable
class IdentifiedEncoder(Protocol):
    """An encoder that can say what its features depend on.

    It is called with bytes, which it turns into floats a pass at a time, and reports its progress
    as ``(frames done, frames)``.
    """

    @property
    def identity(self) -> EncoderIdentity: ...

    @property
    def frames_per_feature(self) -> int:
        """Frames of the clip from a feature frame to the next one."""
        ...

    def __call__(
        self, frames: Tensor, times: Tensor, progress: Callable[[int, int], None] | None = None
    ) -> FeatureMap: ...


@runtime_checkable
class LayeredEncoder(IdentifiedEncoder, Protocol):
    """An encoder of which several layers can be read, from one pass.

    It gives the layer of its identity itself; :meth:`at` is the same network at another.
    """

    @property
    def layers(self) -> tuple[str, ...]:
        """Names, in order of depth."""
        ...

    def at(self, layer: int | str) -> LayeredEncoder: ...

    def encode_layers(
        self,
        frames: Tensor,
        times: Tensor,
        layers: Sequence[int | str],
        progress: Callable[[int, int], None] | None = None,
    ) -> dict[str, FeatureMap]:
        """By the layer's name what :meth:`at` that layer gives."""
        ...


@runtime_checkable
class StreamingEncoder(LayeredEncoder, Protocol):
    """One that need not have a clip whole."""

    def stream(
        self,
        chunks: Callable[[], Iterable[Tensor]],
        size: tuple[int, int],
        times: Tensor,
        layers: Sequence[int | str],
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[FeatureStream]:
        """See :meth:`encoders.frozen.base.FrozenEncoder.stream`."""
        ...


def stream(
    encoder: IdentifiedEncoder,
    chunks: Callable[[], Iterable[Tensor]],
    size: tuple[int, int],
    times: Tensor,
    layers: Sequence[str],
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[FeatureStream]:
    """The features of one clip as they are made; an encoder that cannot do so gets it whole.

    Args:
        encoder: of images or video.
        chunks, size, times, layers, progress: see
            :meth:`encoders.frozen.base.FrozenEncoder.stream`; a plain encoder has one layer.
    """
    if isinstance(encoder, StreamingEncoder):
        return encoder.stream(chunks, size, times, layers, progress)
    import torch

    from encoders.features import streamed

    clip = torch.cat([*chunks()])[None]
    if isinstance(encoder, LayeredEncoder):
        found = encoder.encode_layers(clip, times, layers, progress)
    else:
        found = {layer: encoder(clip, times, progress) for layer in layers}
    return (streamed(layer, features) for layer, features in found.items())
