"""Position readouts: where they look, what they cannot know, and that training keeps the best."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from encoders.features import FeatureMap
from readouts.attention import PRECISE, AttentionReadout, _waves, confidence_at, distance_at
from readouts.pooled import PooledReadout, pooled_twin
from readouts.probes import StateProbe
from readouts.soft_argmax import soft_argmax
from vidphys.data.labelled import LabelledFrames, Shifted, labelled_frames, shift
from vidphys.training.loop import FitSettings
from vidphys.training.readouts import ReadoutSettings, position_rmse, read_all, train_readout

CHANNELS, GRID, STRIDE = 6, (10, 8), (8.0, 8.0)


def feature_map(values: Tensor) -> FeatureMap:
    return FeatureMap(values, STRIDE, torch.arange(values.shape[1]) * 0.1)


def random_readout(bodies: int = 2) -> AttentionReadout:
    readout = AttentionReadout(CHANNELS, bodies, width=16, heads=4)
    with torch.no_grad():
        for parameter in readout.parameters():
            parameter.copy_(torch.randn_like(parameter) / 2)
    readout.fit_scale(3 + 2 * torch.randn(4, CHANNELS, *GRID))
    return readout


def bumps(positions: Tensor, centres: Tensor, noise: float = 0.05) -> Tensor:
    """Features of frames with one blob a body, a channel each, ``(f, c, h, w)``."""
    square = (centres[None, None] - positions[:, :, None, None]).square().sum(-1)
    shape = torch.exp(-square / (2 * 0.15**2))
    values = noise * torch.randn(len(positions), CHANNELS, *centres.shape[:2])
    values[:, : positions.shape[1]] += shape
    return values


def labelled(count: int, bodies: int = 2) -> LabelledFrames:
    centres = feature_map(torch.zeros(1, 1, 1, *GRID)).cell_centres()
    positions = (torch.rand(count, bodies, 2) - 0.5) * torch.tensor([1.2, 1.6])
    return LabelledFrames(bumps(positions, centres), centres, positions, torch.ones(count, bodies))


def test_equals_the_textbook_formula() -> None:
    readout = random_readout()
    features = feature_map(3 + 2 * torch.randn(2, 3, CHANNELS, *GRID))
    positions, _ = readout(features)
    tokens = readout.scale(features.values.flatten(0, 1).flatten(-2).transpose(1, 2))
    cells = features.cell_centres().flatten(0, 1)
    key = (readout.key(tokens) + readout.place(_waves(cells))).unflatten(-1, (4, 4))
    value = readout.value(tokens).unflatten(-1, (4, 4))
    query = readout.query.unflatten(-1, (4, 4))
    score = torch.einsum("nge,fmge->fgnm", query, key) / 2
    attention = score.softmax(-1)
    attended = torch.einsum("fgnm,fmge->fnge", attention, value).flatten(-2)
    seen = torch.einsum("ng,fgnm->fnm", readout.mix.softmax(-1), attention)
    expected = seen @ cells + 0.1 * torch.tanh(readout.correct(attended))
    torch.testing.assert_close(positions.flatten(0, 1), expected, rtol=1e-4, atol=1e-5)


def test_what_is_read_at_a_cell_does_not_depend_on_where_it_is() -> None:
    """Without the place in the keys, a moved map gives a moved position, offset included."""
    readout = random_readout()
    with torch.no_grad():
        readout.place.weight.zero_()
    values = torch.randn(3, CHANNELS, *GRID)
    moved = values.roll((2, -3), dims=(-2, -1))
    centres = feature_map(values[None]).cell_centres()
    torus = torch.stack([torch.roll(centres[..., i], (2, -3), (0, 1)) for i in (0, 1)], -1)
    expected, _ = readout.read(values, centres)
    found, _ = readout.read(moved, torus)
    torch.testing.assert_close(found, expected)


def test_positions_start_inside_the_image() -> None:
    readout = AttentionReadout(CHANNELS, 3)
    positions, confidence = readout(feature_map(torch.randn(2, 5, CHANNELS, *GRID)))
    assert positions.shape == (2, 5, 3, 2) and confidence.shape == (2, 5, 3)
    assert (positions[..., 0].abs() < 0.8).all() and (positions[..., 1].abs() < 1).all()


def test_a_position_on_one_cell_is_its_centre() -> None:
    readout = AttentionReadout(CHANNELS, 1, width=4, heads=1)
    centres = feature_map(torch.zeros(1, 1, 1, *GRID)).cell_centres()
    with torch.no_grad():
        readout.place.weight.zero_()
        readout.query.fill_(1.0)
        readout.key.weight.fill_(1.0)
    values = torch.zeros(1, CHANNELS, *GRID)
    values[..., 2, 5] = 100.0
    torch.testing.assert_close(readout.read(values, centres)[0][0, 0], centres[2, 5])


@given(st.floats(1e-4, 1.0))
def test_confidence_stands_for_a_distance(distance: float) -> None:
    there = torch.tensor(distance, dtype=torch.float64)
    confidence = confidence_at(there)
    assert 0 < confidence < 1
    torch.testing.assert_close(distance_at(confidence), there)
    assert confidence_at(torch.tensor(PRECISE)) == 0.5 and confidence_at(torch.zeros(())) == 1


def test_confidence_tells_dim_frames_from_clear_ones() -> None:
    """Half of the frames are dim and noisy; trained, the readout expects less of them."""
    torch.manual_seed(0)
    train, held_out = labelled(256), labelled(64)
    for data in (train, held_out):
        data.values[::2] = 0.3 * data.values[::2] + 0.1 * torch.randn_like(data.values[::2])
    readout = AttentionReadout(CHANNELS, 2, width=32)
    train_readout(readout, train, held_out, ReadoutSettings(FitSettings(250, 32, 1e-2)), 0)
    positions, confidence = read_all(readout, held_out.values, held_out.centres)
    error = (positions - held_out.targets).norm(dim=-1)
    assert error[::2].median() > 2 * error[1::2].median()
    expected = distance_at(confidence)
    assert expected[::2].median() > 2 * expected[1::2].median()
    assert 0.5 < expected[::2].median() / error[::2].median() < 2


def test_gradients(float64: None) -> None:
    readout = random_readout(bodies=1)
    centres = feature_map(torch.zeros(1, 1, 1, 3, 2)).cell_centres()
    values = torch.randn(1, CHANNELS, 3, 2, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: readout.read(v, centres.double()), (values,))


def test_half_precision_features_are_read_in_full() -> None:
    readout, pooled = random_readout(), PooledReadout(CHANNELS, 2, 8)
    values = torch.randn(2, CHANNELS, *GRID).half()
    centres = feature_map(values[None]).cell_centres()
    for module in (readout, pooled):
        module.fit_scale(values)
        assert module.read(values, centres)[0].dtype == torch.float32


@pytest.mark.parametrize(("channels", "bodies"), [(96, 1), (192, 3), (768, 2)])
def test_the_control_has_the_same_budget(channels: int, bodies: int) -> None:
    readout = AttentionReadout(channels, bodies)
    counts = [
        sum(p.numel() for p in m.parameters())
        for m in (readout, pooled_twin(readout, channels, bodies))
    ]
    assert counts[1] == pytest.approx(counts[0], rel=0.02)


def test_pooling_forgets_where_things_are() -> None:
    readout = PooledReadout(CHANNELS, 2, 8)
    values = torch.randn(1, 4, CHANNELS, *GRID)
    moved = values.roll((3, 2), dims=(-2, -1))
    torch.testing.assert_close(readout(feature_map(values)), readout(feature_map(moved)))


def test_momentum_is_read_from_what_was_kept_and_else_from_all() -> None:
    torch.manual_seed(0)
    probe, values = StateProbe(5, 2, 8), torch.randn(3, 5, 4, 4)
    centres = torch.rand(4, 4, 2)
    place, momentum = probe.read_state(values, centres)
    assert torch.equal(momentum, probe.read_state(values, centres, torch.ones(3, 2, 8))[1])
    none = probe.read_state(values, centres, torch.zeros(3, 2, 8))
    assert torch.equal(none[0], place)
    assert torch.equal(none[1], probe.move(torch.zeros(3, 2, 8)))


def test_of_one_cell_the_place_is_sure() -> None:
    centre = torch.tensor([[[0.25, -0.5]]])
    place, sure = soft_argmax(torch.tensor([[3.0]]), centre)
    assert place.tolist() == [0.25, -0.5] and sure.item() == 1.0


def test_heads_must_divide_the_width() -> None:
    with pytest.raises(ValueError, match="heads = 3 must divide width = 16"):
        AttentionReadout(CHANNELS, 1, width=16, heads=3)


def test_each_frame_of_a_feature_frame_has_offsets_of_its_own() -> None:
    """Queries of two frames may attend to the same cells; their positions still differ."""
    readout = AttentionReadout(CHANNELS, 4, width=16, frames=2)
    values, centres = torch.randn(3, CHANNELS, 5, 5), feature_map(torch.zeros(1, 1, CHANNELS, 5, 5))
    centres = centres.cell_centres()
    before = readout.read(values, centres)[0]
    last = readout.correct[2]
    with torch.no_grad():
        last.bias[2:] = torch.tensor([0.3, -0.2])  # of the second frame
    moved = readout.read(values, centres)[0] - before
    wanted = readout.offset * torch.tensor([0.3, -0.2]).tanh()
    torch.testing.assert_close(moved[:, :2], torch.zeros(3, 2, 2))
    torch.testing.assert_close(moved[:, 2:], wanted.expand(3, 2, 2), atol=1e-6, rtol=0)
    with pytest.raises(ValueError, match="frames = 2 must divide bodies = 3"):
        AttentionReadout(CHANNELS, 3, frames=2)


def test_attention_localises_far_below_a_cell_and_pooling_does_not() -> None:
    train, held_out, test = labelled(192), labelled(32), labelled(64)
    readout = AttentionReadout(CHANNELS, 2, width=32)
    control = pooled_twin(readout, CHANNELS, 2)
    settings = FitSettings(steps=250, batch=16, learning_rate=1e-2)
    rmse = {}
    for name, module in (("attention", readout), ("pooled", control)):
        train_readout(module, train, held_out, ReadoutSettings(settings), seed=0)
        positions, _ = read_all(module, test.values, test.centres)
        rmse[name] = position_rmse(positions, test.targets, test.weight)
    cell = 8 / 40
    assert rmse["attention"] < 0.3 * cell
    assert rmse["pooled"] > 5 * rmse["attention"]


def test_the_best_held_out_weights_are_kept() -> None:
    """With so large a rate the last weights are not the best ones."""
    train, held_out = labelled(8), labelled(64)
    readout = AttentionReadout(CHANNELS, 2, width=16)
    settings = FitSettings(steps=80, batch=8, learning_rate=3e-1)
    seen: list[float] = []

    def distance() -> float:
        positions, _ = read_all(readout, held_out.values, held_out.centres)
        return float((positions - held_out.targets).norm(dim=-1).mean())

    def watch(step: int, steps: int, loss: float) -> None:
        if step % 2 == 0:
            seen.append(distance())

    found = train_readout(
        readout, train, held_out, ReadoutSettings(settings), seed=0, progress=watch
    )
    assert found.held_out_error == pytest.approx(min(seen), rel=1e-5)
    assert distance() == pytest.approx(min(seen), rel=1e-5)
    assert found.kept_step == 2 * (1 + seen.index(min(seen)))
    assert found.kept_step < found.steps == 80
    assert seen[-1] > min(seen)


def test_weight_zero_means_not_looked_at() -> None:
    settings = FitSettings(steps=10, batch=16, learning_rate=1e-2)
    results = []
    for wrong in (0.0, 5.0):
        torch.manual_seed(1)
        data, readout = labelled(32), AttentionReadout(CHANNELS, 2, width=16)
        data.weight[:, 1] = 0
        data.targets[:, 1] += wrong
        train_readout(readout, data, data, ReadoutSettings(settings), seed=0)
        results.append(readout.state_dict())
    for key, value in results[0].items():
        assert torch.equal(value, results[1][key]), key


def test_shift_moves_features_and_targets_alike() -> None:
    centres = feature_map(torch.zeros(1, 1, 1, *GRID)).cell_centres()
    start = torch.stack([centres[4, 3], centres[5, 5]])[None].expand(4, -1, -1)
    frames = LabelledFrames(bumps(start, centres, 0.0), centres, start, torch.ones(4, 2))
    down, right = torch.tensor([0, 2, 0, -5]), torch.tensor([0, -1, 4, 0])
    moved = shift(frames, down, right)
    expected = torch.stack([centres[6, 2], centres[7, 4]])[None]
    torch.testing.assert_close(moved.targets[1:2], expected)
    torch.testing.assert_close(
        moved.values[1:2, :, 3:8, 1:6], bumps(expected, centres, 0.0)[:, :, 3:8, 1:6]
    )
    assert torch.equal(moved.values[0], frames.values[0])
    assert torch.equal(moved.targets[0], frames.targets[0])
    assert moved.weight.tolist() == [[1, 1], [1, 1], [1, 0], [0, 1]]


def test_every_frame_of_a_batch_has_a_move_of_its_own() -> None:
    data = labelled(8)
    moved = Shifted(data, 3)
    assert len(moved) == 8 * 7 * 7
    index = torch.arange(8)
    still = moved[24 * 8 + index]  # the middle one of 49 moves
    assert torch.equal(still.targets, data.targets) and torch.equal(still.values, data.values)
    seen = moved[8 * torch.arange(49)].targets[:, 0]
    assert len({tuple(place) for place in seen.tolist()}) == 49
    assert torch.equal(Shifted(data, 0)[index].targets, data.targets)


def test_bad_input() -> None:
    features = feature_map(torch.zeros(1, 3, CHANNELS, *GRID))
    with pytest.raises(ValueError, match="must be the same frames"):
        labelled_frames(features, torch.zeros(1, 4, 2, 2), torch.ones(1, 4, 2))
    data = labelled(4)
    none = data[torch.zeros(0, dtype=torch.int64)]
    with pytest.raises(ValueError, match="got 4 and 0"):
        settings = ReadoutSettings(FitSettings(1, 1, 1e-3))
        train_readout(PooledReadout(CHANNELS, 2, 4), data, none, settings, 0)
    with pytest.raises(ValueError, match="at least 2 x 2 cells"):
        shift(
            LabelledFrames(data.values[..., :1], data.centres[:, :1], data.targets, data.weight),
            torch.ones(4, dtype=torch.int64),
            torch.zeros(4, dtype=torch.int64),
        )
