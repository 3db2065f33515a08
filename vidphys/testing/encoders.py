"""Whether an encoder keeps its contract."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

import torch
from torch import Tensor

from encoders import Encoder, FeatureMap
from encoders.frozen import load_encoder
from encoders.frozen.foreign import as_ours
from encoders.grid import size_of
from encoders.identity import IdentifiedEncoder, LayeredEncoder
from vidphys.testing.failed import CheckFailed, expect, expect_same, expect_spoiled
from vidphys.testing.states import moving_dots

ALIKE = 1e-4  # relative, of single-precision features that were computed in another order
CLIPS, FRAMES = 2, 8


def check_encoder(
    encoder: str | Encoder | IdentifiedEncoder, side: int = 64, **options: Any
) -> None:
    """Check an encoder: everything that `extract`, `train` and the ladder rely on.

    Shapes, a grid that covers the picture, increasing times within the clip, bytes as floats, the
    same features twice and in any company, a NaN refused, and an identity that can be filed.

    Args:
        encoder: a registered name, a ``package.module:factory``, or an encoder.
        side: pixels of the square frames that it is shown.
        options: of a name's factory.

    Raises:
        CheckFailed: what was expected, and what came.
    """
    name = encoder if isinstance(encoder, str) else type(encoder).__name__
    made: IdentifiedEncoder
    if isinstance(encoder, str):
        made = load_encoder(encoder, options)
    elif isinstance(encoder, IdentifiedEncoder):
        made = encoder
    else:
        _check_plain(encoder, name, side)
        made = as_ours(encoder, name, "check", {})
    frames, times = moving_dots(CLIPS, FRAMES, side)
    found = _called(made, frames, times, name)
    _check_map(found, name, made.frames_per_feature, times, side)
    again = _called(made, frames, times, name).values
    expect(torch.equal(found.values, again), name, "the same features twice", "others")
    floats = _called(made, frames.float() / 255, times, name).values
    expect_same(floats, found.values, name, "of bytes what it gives of floats", ALIKE)
    for clip in range(CLIPS):
        alone = _called(made, frames[clip : clip + 1], times, name).values[0]
        expect_same(alone, found.values[clip], name, "a clip alone as in company", ALIKE)
    other = _called(made, 255 - frames, times, name).values
    expect(not torch.equal(other, found.values), name, "other features of other frames", "the same")
    spoiled = frames.float() / 255
    spoiled[0, 0, 0, 0, 0] = math.nan
    expect_spoiled(lambda: made(spoiled, times).values[0], f"{name} of a NaN pixel")
    if isinstance(made, LayeredEncoder):
        _check_layers(made, name, frames, times)
    held = asdict(made.identity)
    expect(json.loads(json.dumps(held)) == held, f"{name}.identity", "plain words", held)


def _called(encoder: Any, frames: Tensor, times: Tensor, name: str) -> FeatureMap:
    try:
        found = encoder(frames, times)
    except ValueError as error:
        shape = tuple(frames.shape)
        raise CheckFailed(f"{name}: expected features of frames {shape}, got {error}") from error
    expect(isinstance(found, FeatureMap), name, "an encoders.FeatureMap", type(found).__name__)
    return found


def _check_layers(encoder: LayeredEncoder, name: str, frames: Tensor, times: Tensor) -> None:
    """All layers of one pass are those of an encoder at each; its own is one of them."""
    own, layers = encoder.identity.layer, encoder.layers
    expect(own in layers, f"{name}.layers", f"its own layer {own!r} among them", layers)
    together = encoder.encode_layers(frames, times, layers)
    expect(tuple(together) == layers, f"{name}: encode_layers", layers, tuple(together))
    for layer, found in together.items():
        at = encoder.at(layer)
        expect(at.identity.layer == layer, f"{name}.at({layer!r})", layer, at.identity.layer)
        _check_map(found, f"{name} at {layer}", at.frames_per_feature, times, frames.shape[-1])
        alone = _called(at, frames, times, name).values
        expect_same(found.values, alone, f"{name} at {layer}", "what it gives alone", ALIKE)


def _check_map(found: FeatureMap, name: str, each: int, times: Tensor, side: int) -> None:
    expect(isinstance(each, int) and each >= 1, f"{name}.frames_per_feature", "a count", each)
    values, wanted = found.values, -(-FRAMES // each)
    expect(values.ndim == 5, name, "features (b, t, c, h, w)", tuple(values.shape))
    shape = tuple(values.shape[:2])
    expect(shape == (CLIPS, wanted), name, f"{CLIPS} clips of {wanted} feature frames", shape)
    expect(values.is_floating_point(), name, "floating-point features", values.dtype)
    expect(bool(torch.isfinite(values).all()), name, "finite features", "others")
    stamps = found.times
    expect(tuple(stamps.shape) == (wanted,), f"{name}: times", f"({wanted},)", tuple(stamps.shape))
    inside = bool((stamps >= times[0]).all() and (stamps <= times[-1]).all())
    expect(inside, f"{name}: times", "seconds within the clip", stamps.tolist())
    expect(bool((stamps.diff() > 0).all()), f"{name}: times", "increasing", stamps.tolist())
    covered = size_of(found.stride, values.shape)
    good = all(abs(pixels - side) <= max(found.stride[:2]) for pixels in covered)
    expect(good, f"{name}: grid times stride", f"the picture's {side} pixels", [*covered])


def _check_plain(encoder: Any, name: str, side: int) -> None:
    """A plain encoder as its author may call it: floats, several clips at once."""
    frames, times = moving_dots(CLIPS, FRAMES, side)
    seen = frames.float() / 255
    with torch.no_grad():
        together = _called(encoder, seen, times, name).values
        for clip in range(CLIPS):
            alone = _called(encoder, seen[clip : clip + 1], times, name).values[0]
            expect_same(alone, together[clip], name, "a clip alone as in company", ALIKE)
