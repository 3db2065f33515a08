"""Eight bits: the mean over cells as it was, all else within a step; so they lie in a store."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from safetensors.torch import load

from encoders.arrays import FeatureArrays, bytes_kept, fewer_cells
from encoders.features import FeatureMap
from encoders.manifests import StaleFeatures
from encoders.quantised import LEVELS, quantised
from encoders.store import FeatureStore
from tests.shared.stored import TIMES, made, parts_of, request

ULP = 2.0**-23
shapes = st.tuples(*(st.integers(1, most) for most in (3, 3, 5, 5)))
magnitudes = st.sampled_from([0.0, 1e-30, 1e-3, 1.0, 300.0, 1e5, 1e30])


@st.composite
def maps(draw):
    """Channels of any size around any mean."""
    shape = draw(shapes)
    spread = draw(arrays(np.float64, shape, elements=st.floats(-1, 1)))
    loud, mean = (draw(arrays(np.float64, (*shape[:2], 1, 1), elements=magnitudes)) for _ in "ab")
    return (spread * loud + mean).astype(np.float32)


def largest(values):
    return np.abs(values).max((-2, -1), keepdims=True).astype(np.float64)


@given(maps())
def test_each_channel_errs_by_a_step_at_most_and_its_mean_by_nothing(values):
    kept = quantised(values)
    found = kept.numbers()
    assert (kept.values.dtype, found.dtype) == (np.int8, np.float32)
    wide = values.max((-2, -1), keepdims=True) - values.min((-2, -1), keepdims=True).astype(float)
    rounding = 4 * ULP * largest(values) + 1e-35  # of the numbers themselves, and of none
    assert (np.abs(found.astype(float) - values) <= wide / (2 * LEVELS) + rounding).all()
    means = [each.mean((-2, -1), dtype=float, keepdims=True) for each in (found, values)]
    assert (np.abs(means[0] - means[1]) <= ULP * largest(values) + 1e-35).all()
    assert np.array_equal(kept.mean, means[1][..., 0, 0].astype(np.float32))


@given(maps())
def test_what_was_kept_once_stays_as_it_is(values):
    once = quantised(values).numbers()
    again = quantised(once).numbers()
    assert (np.abs(again - once) <= 8 * ULP * largest(once) + 1e-35).all()


@given(arrays(np.float32, (2, 3, 1, 1), elements=st.floats(width=32, allow_nan=False)))
def test_a_constant_stays_to_the_bit(values):
    values = np.where(np.isfinite(values), values, np.float32(3e38))
    flat = np.broadcast_to(values, (2, 3, 4, 5))
    assert np.array_equal(quantised(flat).numbers(), flat)


def test_half_a_step_where_cells_are_many():
    """A loud cell makes a coarse step; the channels beside it keep theirs."""
    values = np.random.default_rng(0).standard_normal((2, 3, 16, 16)).astype(np.float32)
    values[:, 1] *= 1e4
    step = (values.max((-2, -1)) - values.min((-2, -1)))[..., None, None] / (2 * LEVELS)
    error = np.abs(quantised(values).numbers() - values) / step
    assert 0.45 < error.max() < 0.6


eight = dataclasses.replace(request(0), dtype="int8")


@pytest.mark.parametrize("packed", [False, True])
def test_a_store_gives_them_back_as_numbers_and_says_what_it_lost(tmp_path, packed):
    store, whole = FeatureStore(tmp_path), made(0)
    written = store.get(eight, "clip.mp4", lambda: whole)
    if packed:
        assert store.pack() == 1
        store = FeatureStore(tmp_path)
    found, plain = store.read(eight), store.arrays(eight)
    assert found.values.dtype == torch.float32 and torch.equal(found.values, written.values)
    assert np.array_equal(plain.values, found.values[0].numpy())
    assert torch.equal(found.times, TIMES) and found.stride == whole.stride == plain.stride
    means = [each.values.double().mean((-2, -1)) for each in (found, whole)]
    assert (means[0] - means[1]).abs().max() < 1e-7
    (manifest,) = store.entries()
    away = float((found.values - whole.values).norm() / whole.values.norm())
    assert 1e-4 < away < 1e-2 and manifest["stored_error"] == pytest.approx(away, rel=5e-3)
    assert manifest["shape"] == [2, 5, 4, 2] and store.shape_of(eight) == (2, 5, 4, 2)
    assert store.verify() == []


def test_any_reader_of_safetensors_finds_the_parts(tmp_path):
    store = FeatureStore(tmp_path)
    store.write(eight, "clip.mp4", FeatureMap(made(0).values[..., :3, :1], (16.0, 32.0), TIMES))
    (entry,) = (tmp_path / "entries").iterdir()
    tensors, _ = parts_of(entry)
    parts = load(tensors)
    kept = quantised(made(0).values[0, ..., :3, :1].numpy())
    assert parts.keys() == {"times", "values", "scale", "mean"}
    for name in ("values", "scale", "mean"):
        assert np.array_equal(parts[name].numpy(), getattr(kept, name))
    (manifest,) = store.entries()
    header = 8 + int.from_bytes(tensors[:8], "little") + TIMES.numel() * 8
    assert manifest["bytes"] == len(tensors) == header + bytes_kept((2, 5, 3, 1), "int8")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("form", [torch.from_numpy, np.asarray])
def test_what_is_no_number_is_refused(tmp_path, bad, form):
    values = np.ones((2, 5, 4, 2), np.float32)
    values[1, 2, 3, 1] = bad
    store = FeatureStore(tmp_path)
    if form is np.asarray:
        features = FeatureArrays(values, (12.0, 16.0), TIMES.numpy())
    else:
        features = FeatureMap(form(values)[None], (12.0, 16.0), TIMES)
    with pytest.raises(ValueError, match="clip.mp4 are not finite in int8"):
        store.write(eight, "clip.mp4", features)
    assert not store.has(eight)


def test_a_flipped_bit_is_found(tmp_path):
    store = FeatureStore(tmp_path)
    store.write(eight, "clip.mp4", made(0))
    (entry,) = (tmp_path / "entries").iterdir()
    content = bytearray(entry.read_bytes())
    content[content.index(b"mean") + 200] ^= 1
    entry.write_bytes(content)
    with pytest.raises(StaleFeatures, match="damaged"):
        FeatureStore(tmp_path).read(eight)


# fewer cells


def test_fewer_cells_are_the_means_over_their_blocks():
    values = torch.randn(2, 3, 7, 10, generator=torch.Generator().manual_seed(0))
    for most in (1, 4, 7, 8):
        found = fewer_cells(values.numpy(), most)
        wanted = torch.nn.functional.adaptive_avg_pool2d(values, (min(7, most), min(10, most)))
        assert np.allclose(found, wanted.numpy(), atol=1e-6)
    assert fewer_cells(values.numpy(), 10) is not None
    assert np.array_equal(fewer_cells(values.numpy(), 12), values.numpy())


@pytest.mark.parametrize("dtype", ["float16", "int8"])
def test_a_pooled_map_is_another_entry_than_the_whole_one(tmp_path, dtype):
    whole = dataclasses.replace(request(0), dtype=dtype)
    pooled = dataclasses.replace(whole, grid=2)
    store = FeatureStore(tmp_path)
    store.write(pooled, "clip.mp4", made(0))
    assert store.read(whole) is None and not store.has(whole)
    assert store.read(dataclasses.replace(whole, grid=3)) is None
    found = store.read(pooled)
    assert found.values.shape == (1, 2, 5, 2, 2) and found.stride == (24.0, 16.0)
    blocks = made(0).values.unflatten(3, (2, 2)).mean(4)
    assert torch.allclose(found.values.float(), blocks, atol=2e-2)
    store.write(whole, "clip.mp4", made(0))
    assert store.read(whole).values.shape == (1, 2, 5, 4, 2)
    assert store.read(pooled).values.shape == (1, 2, 5, 2, 2)


def test_a_request_of_before_there_were_grids_has_the_key_that_it_had():
    assert request(0).key.startswith("02800f79e1608e57")
    assert "grid" not in request(0).told
