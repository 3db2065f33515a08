"""Readouts that read twice: the second reading is the same everywhere, and tells what to expect."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from encoders.features import FeatureMap
from readouts.attention import distance_at
from readouts.local import LocalReadout, RefinedReadout, blocks, nearest_cells
from readouts.scale import FeatureScale
from vidphys.data.labelled import LabelledFrames, joined
from vidphys.training.early_stopping import StopSettings
from vidphys.training.learner import FitSettings
from vidphys.training.readouts import ReadoutSettings, mean_distance, read_all
from vidphys.training.refinement import Glances, train_refined

CHANNELS, GRID = 4, (10, 8)


def grid() -> Tensor:
    return FeatureMap(torch.zeros(1, 1, 1, *GRID), (8.0, 8.0), torch.zeros(1)).cell_centres()


def labelled(count: int) -> LabelledFrames:
    """One blob a body, a channel each; the first one hides the other. Every second frame is dim."""
    centres = grid()
    positions = (torch.rand(count, 2, 2) - 0.5) * torch.tensor([1.2, 1.6])
    square = (centres - positions[:, :, None, None]).square().sum(-1)
    first, second = torch.exp(-square / (2 * 0.15**2)).unbind(1)
    values = 0.02 * torch.randn(count, CHANNELS, *GRID)
    bright = torch.tensor([1.0, 0.2]).repeat(count // 2)[:, None, None]
    values[:, 0] += bright * first
    values[:, 1] += bright * second * (1 - first)
    return LabelledFrames(values, centres, positions, torch.ones(count, 2))


def test_the_nearest_cell_is_the_nearest_and_never_outside() -> None:
    centres = grid()
    near = centres[3, 5] + torch.tensor([0.09, -0.09])
    far = torch.tensor([9.0, 9.0])
    assert nearest_cells(torch.stack([near, far])[None], centres).tolist() == [[[3, 5], [0, 7]]]


def test_what_is_read_does_not_depend_on_where_it_is() -> None:
    torch.manual_seed(0)
    local, centres = LocalReadout(FeatureScale(CHANNELS), 2, reach=1), grid()
    values = torch.zeros(1, CHANNELS, *GRID)
    values[..., 3:6, 2:5] = torch.randn(1, CHANNELS, 3, 3)
    moved = values.roll((2, 1), dims=(-2, -1))
    step = centres[2, 1] - centres[0, 0]
    near = centres[4, 3] + torch.tensor([[[0.03, -0.02], [-0.05, 0.04]]])
    here, _ = local(values, centres, near)
    there, _ = local(moved, centres, near + step)
    torch.testing.assert_close(there, here + step)
    assert not torch.allclose(here[:, 0], here[:, 1])


@pytest.mark.parametrize("corner", [(0, 0), (-1, -1)])
def test_beyond_the_border_there_is_nothing(corner: tuple[int, int]) -> None:
    """A body in the corner is read as if the map went on with the mean of its features."""
    torch.manual_seed(0)
    local, centres = LocalReadout(FeatureScale(CHANNELS), 1, reach=2), grid()
    values = torch.randn(1, CHANNELS, *GRID)
    wide = torch.nn.functional.pad(values, (2, 2, 2, 2))
    step = centres[1, 1] - centres[0, 0]
    rows, columns = (torch.arange(n + 4) - 2 for n in GRID)
    cells = torch.stack(torch.meshgrid(rows, columns, indexing="ij")[::-1], -1)
    near = centres[corner][None, None]
    want, _ = local(wide, centres[0, 0] + cells * step, near)
    torch.testing.assert_close(local(values, centres, near)[0], want)


def test_a_second_reading_is_nearer_and_knows_how_near() -> None:
    torch.manual_seed(0)
    train, held_out, unseen = labelled(512), labelled(128), labelled(256)
    readout = RefinedReadout(CHANNELS, 2, GRID)
    settings = ReadoutSettings(FitSettings(900, 64, 1e-2, 1.0), stop=StopSettings(10))
    fit = train_refined(readout, train, held_out, settings, 0)
    assert fit.held_out_error == pytest.approx(mean_distance(readout, held_out))
    assert mean_distance(readout, unseen) < 0.5 * mean_distance(readout.coarse, unseen)
    positions, confidence = read_all(readout, unseen.values, unseen.centres)
    error, expected = (positions - unseen.targets).norm(dim=-1), distance_at(confidence)
    assert error[1::2].median() > 2 * error[::2].median()
    assert expected[1::2].median() > 2 * expected[::2].median()
    assert 0.5 < expected.median() / error.median() < 2


def test_attention_reads_a_fine_map_by_blocks() -> None:
    """Their centres are the means of the cells', so what is found is where it is."""
    values = torch.randn(2, CHANNELS, 32, 32)
    centres = FeatureMap(values[None], (2.0, 2.0), torch.zeros(2)).cell_centres()
    readout = RefinedReadout(CHANNELS, 3, (32, 32))
    assert readout.block == 2 and readout.local.reach == 2
    rough, middle = blocks(values, centres, 2)
    coarse = FeatureMap(rough[None], (4.0, 4.0), torch.zeros(2)).cell_centres()
    torch.testing.assert_close(middle, coarse)
    torch.testing.assert_close(rough[1, 2, 3, 5], values[1, 2, 6:8, 10:12].mean())
    assert readout.read(values, centres)[0].shape == (2, 3, 2)


def test_a_grid_of_one_cell_is_refused() -> None:
    frames = LabelledFrames(
        torch.zeros(1, 2, 1, 1), torch.zeros(1, 1, 2), torch.zeros(1, 1, 2), torch.ones(1, 1)
    )
    with pytest.raises(ValueError, match="at least 2 x 2 cells, got 1 x 1"):
        _ = frames.cell


def test_joined_frames_are_the_same_frames_channels_last() -> None:
    first, second = labelled(4), labelled(2)
    both = joined([first, second], 6)
    assert torch.equal(both.values, torch.cat([first.values, second.values]))
    assert torch.equal(both[torch.tensor([5])].targets, second.targets[1:])
    assert both.values.is_contiguous(memory_format=torch.channels_last)
    assert not both.values.is_contiguous()


def test_a_glance_reads_what_the_whole_map_gives_there() -> None:
    torch.manual_seed(0)
    local, frames = LocalReadout(FeatureScale(CHANNELS), 2, reach=1), labelled(6)
    found = torch.full_like(frames.targets, -0.5)
    chosen = torch.tensor([4, 1] * 20)
    glance = Glances(local, frames, found, torch.Generator())[chosen]
    middle = frames.centres[glance.cells[..., 0], glance.cells[..., 1]]
    near = ((middle - glance.targets).abs() / frames.cell).amax((-2, -1)) <= 1.0
    lost = (nearest_cells(found[chosen], frames.centres) == glance.cells).flatten(1).all(1)
    assert bool((near | lost).all()) and 5 < int(lost.sum()) < 35
    want, _ = local(frames.values[chosen], frames.centres, middle)
    (found,), _ = local.read(glance.seen, glance.cells, glance.centres)
    torch.testing.assert_close(found, want)


@pytest.mark.slow
def test_readers_that_learned_apart_are_nearer_together_and_their_spread_tells() -> None:
    torch.manual_seed(2)
    train, held_out, unseen = labelled(128), labelled(128), labelled(256)
    readout = RefinedReadout(CHANNELS, 2, GRID, readers=3)
    settings = ReadoutSettings(FitSettings(900, 64, 1e-2, 1.0), stop=StopSettings(10))
    train_refined(readout, train, held_out, settings, 0)
    local = readout.local
    cells = nearest_cells(unseen.targets, unseen.centres)
    with torch.no_grad():
        seen = local.cut(unseen.values, torch.arange(256), cells)
        each, _ = local.read(seen, cells, unseen.centres)
        together, evidence = local(unseen.values, unseen.centres, unseen.targets)
    alone = (each - unseen.targets).norm(dim=-1).mean((1, 2))
    error = (together - unseen.targets).norm(dim=-1)
    assert float(error.mean()) < 0.97 * float(alone.mean())
    spread = evidence[..., -1]
    assert error[spread > spread.median()].mean() > 1.5 * error[spread < spread.median()].mean()
