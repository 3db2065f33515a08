"""What every encoder's layers are held to: one pass gives what an encoder of each layer gives."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from encoders.frozen import FrozenEncoder


def expect_layers(
    encoder: FrozenEncoder, alone: Callable[[str], FrozenEncoder], frames: Tensor, passes: int
) -> None:
    """Compare all layers read together with an encoder loaded for each.

    Args:
        encoder: whose layers are read.
        alone: loads the encoder of one layer.
        frames: ``(b, t, c, H, W)``.
        passes: of the network's windows that are known to be needed.
    """
    times = torch.arange(frames.shape[1], dtype=torch.float64) / 10
    ran: list[tuple[str, ...]] = []
    original = encoder.encode
    encoder.encode = lambda x, layers: ran.append(layers) or original(x, layers)  # type: ignore[method-assign,func-returns-value]
    reached: list[tuple[int, int]] = []
    found = encoder.encode_layers(frames, times, encoder.layers, lambda *told: reached.append(told))
    del encoder.encode  # type: ignore[method-assign]
    assert tuple(found) == encoder.layers and len(ran) == passes
    count = frames.shape[0] * frames.shape[1]
    assert reached[-1] == (count, count) and reached == sorted(reached)
    for layer, features in found.items():
        single = alone(layer)
        assert single.identity == encoder.at(layer).identity
        assert single.frames_per_feature == encoder.at(layer).frames_per_feature
        for told in (single(frames, times), encoder.at(layer)(frames, times)):
            assert torch.equal(features.values, told.values)
            assert torch.equal(features.times, told.times) and features.stride == told.stride
        assert not features.values.is_inference()
    deep, shallow = encoder.layers[-1], encoder.layers[0]
    both = encoder.encode_layers(frames, times, (deep, shallow))
    assert tuple(both) == tuple(dict.fromkeys((deep, shallow)))
    assert torch.equal(both[deep].values, found[deep].values)
