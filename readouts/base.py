"""What every readout of positions offers: feature frames in, positions and confidence out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from jaxtyping import Float
from torch import Tensor, nn

from encoders.features import FeatureMap


class Readout(Protocol):
    """Anything that tells where N bodies are in each feature frame by itself."""

    def read(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n"]]:
        """Positions in normalised image units, y upwards, and their confidence in [0, 1].

        Where a feature frame stands for several frames of the clip, the bodies of the first of
        them come first, then those of the next.

        Args:
            values: features of frames, of any float type.
            centres: (x, y) of the cells, normalised image units.
        """
        ...


class FrameReadout(nn.Module, ABC):
    """A :class:`Readout` with weights, which can be trained on frames with known positions."""

    def forward(
        self, features: FeatureMap
    ) -> tuple[Float[Tensor, "b t n 2"], Float[Tensor, "b t n"]]:
        """As :meth:`read`, of whole clips."""
        b, t = features.values.shape[:2]
        centres = features.cell_centres().to(features.values.device)
        positions, confidence = self.read(features.values.flatten(0, 1), centres)
        return positions.unflatten(0, (b, t)), confidence.unflatten(0, (b, t))

    @abstractmethod
    def read(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n"]]:
        """See :class:`Readout`."""

    def fit_scale(self, values: Float[Tensor, "f c h w"]) -> None:  # noqa: B027
        """Take what statistics it needs of the training features, before training; here none."""
