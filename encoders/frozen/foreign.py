"""An encoder of another package, as the stages see one of ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from encoders.features import Encoder, FeatureMap
from encoders.frozen.base import FrozenEncoder, check_frames
from encoders.frozen.tokens import chosen_layer
from encoders.identity import EncoderIdentity, LayeredEncoder
from encoders.release import release_sha256


@dataclass(frozen=True)
class ForeignEncoder:
    """A plain encoder, given one clip at a time, so that no clip knows of its company.

    Args:
        network: floats in [0, 1] to features. Its ``frames_per_feature`` is 1 where it has none.
        identity: what its features depend on.
    """

    network: Encoder
    identity: EncoderIdentity

    @property
    def frames_per_feature(self) -> int:
        """Frames of the clip from a feature frame to the next one."""
        return getattr(self.network, "frames_per_feature", 1)

    def __call__(
        self, frames: Tensor, times: Tensor, progress: Callable[[int, int], None] | None = None
    ) -> FeatureMap:
        """As :class:`encoders.frozen.base.FrozenEncoder` is called.

        Raises:
            ValueError: see there; or features of another type or shape than was promised.
        """
        check_frames(self.identity.name, frames, times)
        each, count = frames.shape[1], frames.shape[0] * frames.shape[1]
        found: list[FeatureMap] = []
        for clip in frames:
            seen = clip.float() if clip.is_floating_point() else clip.float() / 255
            with torch.no_grad():
                found.append(self._checked(self.network(seen[None], times), each))
            if progress is not None:
                progress(len(found) * each, count)
        values = torch.cat([features.values for features in found])
        return FeatureMap(values, found[0].stride, found[0].times)

    @property
    def layers(self) -> tuple[str, ...]:
        """The one that it was made for."""
        return (self.identity.layer,)

    def at(self, layer: int | str) -> ForeignEncoder:
        """Itself.

        Raises:
            ValueError: another layer.
        """
        chosen_layer(self.identity.name, layer, self.layers)
        return self

    def encode_layers(
        self,
        frames: Tensor,
        times: Tensor,
        layers: Sequence[int | str],
        progress: Callable[[int, int], None] | None = None,
    ) -> dict[str, FeatureMap]:
        """See :meth:`encoders.frozen.base.FrozenEncoder.encode_layers`."""
        asked = {self.at(layer).identity.layer for layer in layers}
        return {layer: self(frames, times, progress) for layer in asked}

    def _checked(self, features: FeatureMap, frames: int) -> FeatureMap:
        if not isinstance(features, FeatureMap):
            raise ValueError(
                f"{self.identity.name}: must return an encoders.FeatureMap, got "
                f"{type(features).__name__}"
            )
        wanted, shape = -(-frames // self.frames_per_feature), tuple(features.values.shape)
        if len(shape) != 5 or shape[:2] != (1, wanted) or len(features.times) != wanted:
            raise ValueError(
                f"{self.identity.name}: one clip of {frames} frames must give features (1, "
                f"{wanted}, c, h, w) and {wanted} times, got {shape} and {len(features.times)}"
            )
        return features


def as_ours(made: Any, name: str, source: str, options: dict[str, Any]) -> LayeredEncoder:
    """What a foreign factory made, its source in its identity: other versions, other features.

    Args:
        made: a :class:`FrozenEncoder`, or any :class:`Encoder`.
        name: that it was asked for by.
        source: distribution and version.
        options: that it was made with.
    """
    if isinstance(made, FrozenEncoder):
        words = f"{made.identity.preprocessing}; {source}"
        made.identity = replace(made.identity, preprocessing=words)
        return made
    weights: Path | None = options.get("weights")
    told = {key: options[key] for key in sorted(options) if key not in ("weights", "device")}
    identity = EncoderIdentity(
        name=name,
        code_version=getattr(made, "code_version", 1),
        weights_sha256="" if weights is None else release_sha256(weights),
        preprocessing=f"{source}, {told}",
        layer=str(options.get("layer", "")),
        resolution=int(options.get("resolution", 0)),
        dtype=str(options.get("dtype", "float32")),
    )
    return ForeignEncoder(made, identity)
