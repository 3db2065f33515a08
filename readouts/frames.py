"""Readouts of single frames, and of the clips that these come from."""

from __future__ import annotations

from abc import ABC, abstractmethod

from jaxtyping import Float
from torch import Tensor, nn

from encoders.features import FeatureMap


class FrameReadout(nn.Module, ABC):
    """Positions of N bodies in each feature frame by itself."""

    def forward(
        self, features: FeatureMap
    ) -> tuple[Float[Tensor, "b t n 2"], Float[Tensor, "b t n"]]:
        """Positions in normalised image units and their confidence in [0, 1]."""
        b, t = features.values.shape[:2]
        centres = features.cell_centres().to(features.values.device)
        positions, confidence = self.read(features.values.flatten(0, 1), centres)
        return positions.unflatten(0, (b, t)), confidence.unflatten(0, (b, t))

    @abstractmethod
    def read(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n"]]:
        """As :meth:`forward`, on frames without their clip.

        Args:
            values: features of frames.
            centres: of the cells, normalised image units.
        """
