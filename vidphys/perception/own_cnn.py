"""Our own trained CNN in the place of a frozen encoder, for the same readouts over it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import torch
from torch import Tensor

from encoders.cnn import ConvEncoder
from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from vidphys.perception.base import FitTask, Perception
from vidphys.perception.cnn import CHUNK, CnnPerception, fit_supervised
from vidphys.perception.frozen import fit_readout
from vidphys.placement import device_of
from vidphys.reading.reader import LoadedEncoder

NAME = "cnn-frozen"
CODE_VERSION = 1


class OwnCnn:
    """A trained :class:`ConvEncoder` that is trained no further.

    Args:
        network: gives feature maps of bytes turned into [0, 1].
        image: pixels of the longer side of the frames that it was trained on.
    """

    frames_per_feature = 1

    def __init__(self, network: ConvEncoder, image: int) -> None:
        self.network = network.eval().requires_grad_(False)
        self.identity = EncoderIdentity(
            name=NAME,
            code_version=CODE_VERSION,
            weights_sha256=_digest(network),
            preprocessing="in 0..1",
            layer="last",
            resolution=image,
            dtype="float32",
        )

    def __call__(
        self, frames: Tensor, times: Tensor, progress: Callable[[int, int], None] | None = None
    ) -> FeatureMap:
        """Encode clips of bytes, each frame by itself."""
        device = device_of(self.network)
        parts = [self.network(some.to(device).float() / 255, times) for some in frames.split(CHUNK)]
        return FeatureMap(torch.cat([p.values for p in parts]), parts[0].stride, times)


def fit_own_cnn(task: FitTask, pooled: bool = False) -> Perception:
    """Train the CNN on true positions, freeze it, and train a fresh readout over its features.

    Args:
        task: see :class:`FitTask`.
        pooled: the control in place of spatial attention.
    """
    trained = fit_supervised(task)
    assert isinstance(trained, CnnPerception)
    encoder = OwnCnn(trained.encoder, max(task.clips.frames.shape[-2:]))
    return fit_readout(LoadedEncoder(NAME, {}, encoder), task, pooled, together=1)


def _digest(network: ConvEncoder) -> str:
    digest = hashlib.sha256()
    for name, value in sorted(network.state_dict().items()):
        digest.update(name.encode() + value.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
