from dataclasses import replace

import numpy as np
import pytest
import torch

from encoders.features import FeatureMap
from encoders.store import FeatureStore
from tests.shared.stored import request
from vidphys.probing.findings import Asked, findings_of
from vidphys.probing.keeping import KEPT
from vidphys.probing.readouts import Linear
from vidphys.probing.targets import Labels


def maps_of(count=80, side=8):
    return torch.randn(count, 3, side, side, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("loud", [1e-3, 1.0, 100.0])
def test_eight_bits_err_by_half_a_step_of_each_channel(loud):
    maps = maps_of() * torch.tensor([1.0, 50.0, 1e-3]).reshape(1, 3, 1, 1) * loud
    step = (maps.amax((-2, -1), keepdim=True) - maps.amin((-2, -1), keepdim=True)) / 254
    error = (KEPT["int8"].keep(maps) - maps).abs()
    assert (error <= 0.65 * step).all()
    assert (error > 0.4 * step).any()


@pytest.mark.parametrize("name", ["int8", "4x4-int8"])
def test_eight_bits_keep_the_mean_over_cells(name):
    """Of maps that one loud cell gives a coarse step; the mean changes by a thousandth of it."""
    maps = maps_of(40) + 300
    maps[:, :, 0, 0] = 1000
    maps += torch.arange(40.0).reshape(-1, 1, 1, 1) * 1e-3
    means = [each.mean((-2, -1), dtype=torch.float64) for each in (KEPT[name].keep(maps), maps)]
    assert (means[0] - means[1]).abs().max() < 1e-4


def test_a_silent_channel_stays_silent():
    assert KEPT["int8"].keep(torch.zeros(1, 2, 3, 3)).eq(0).all()


def test_what_is_kept_takes_as_many_bytes_as_said():
    maps = maps_of()
    cells = KEPT["4x4"].keep(maps)
    assert cells.shape == (80, 3, 4, 4)
    assert cells[0, 0, 0, 1] == pytest.approx(float(maps[0, 0, :2, 2:4].mean()), abs=1e-6)
    bytes_of = {name: keeping.bytes(3, 8, 8) for name, keeping in KEPT.items()}
    assert bytes_of == {"int8": 3 * 72, "4x4": 3 * 16 * 2, "4x4-int8": 3 * 24}
    assert KEPT["4x4"].bytes(3, 2, 8) == 2 * 3 * 2 * 4


def test_the_cost_of_each_is_measured_where_it_lies():
    """One number stands in a single cell, another in all cells of a quarter."""
    maps = maps_of()
    fine, coarse = maps[:, 0, 3, 5], maps[:, 1, :4, :4].mean((-2, -1))
    values = [part.double().numpy()[:, None] for part in (fine, coarse)]
    targets = [Labels(n, "regression", "frame", v) for n, v in zip("fc", values, strict=True)]
    asked = Asked(targets, np.arange(80), np.arange(80), 0, 4, Linear(("cells",)), tuple(KEPT))
    one, other = findings_of("1", 0.0, 10 * maps, {}, {}, asked)
    assert one.kept["4x4"][0].high < -0.1 and abs(one.kept["int8"][0].value) < 0.02
    assert other.kept["4x4"][0].low > -0.02
    assert {name: bytes_each for name, (_, bytes_each) in one.kept.items()} == {
        name: keeping.bytes(3, 8, 8) for name, keeping in KEPT.items()
    }


@pytest.mark.parametrize("name, most", [("int8", None), ("4x4-int8", 4)])
def test_what_is_measured_is_what_a_store_gives_back(tmp_path, name, most):
    maps, store = maps_of(5), FeatureStore(tmp_path)
    times = torch.arange(5.0, dtype=torch.float64)
    asked = replace(request(0), dtype="int8", grid=most)
    store.write(asked, "clip.mp4", FeatureMap(maps[None], (4.0, 4.0), times))
    assert torch.equal(store.read(asked).values[0], KEPT[name].keep(maps))
    (manifest,) = store.entries()
    headed = manifest["bytes"] - 5 * KEPT[name].bytes(3, 8, 8) - 5 * 8
    assert 0 < headed < 400
