"""Probes: they find momentum where features hold it, and nowhere else; the table's views."""

from types import SimpleNamespace

import pytest
import torch

from dynamics import PhaseState
from encoders.features import FeatureMap
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.windows import Windowing
from readouts.attention import AttentionReadout
from readouts.probes import StateProbe, side_by_side
from readouts.scale import FeatureScale
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.pixels import probes, temporal_views
from vidphys.presets import OracleSizes, PixelSizes
from vidphys.runs.records import merged_tables
from vidphys.training.learner import FitSettings
from vidphys.training.probes import StateFrames, Units, train_probes

GRID, BODIES = (8, 8), 2
HALF = 4.0  # world units
SETTINGS = FitSettings(70, 32, 2e-2, 1.0)
TINY = PixelSizes(24, 5, 40, 32, 4, 8, 1, 4)


def centres():
    return FeatureMap(torch.zeros(1, 1, 1, *GRID), (8.0, 8.0), torch.zeros(1)).cell_centres()


def states(count, seed=0):
    rng = torch.Generator().manual_seed(seed)
    q = HALF * 0.7 * (2 * torch.rand(count, BODIES, 2, generator=rng) - 1)
    return PhaseState(q, 0.5 * torch.randn(count, BODIES, 2, generator=rng))


def features(truth, moving):
    """A blob a body in a channel of its own; channels with its momentum there, if it is shown."""
    place = centres()[None, None] - truth.q[:, :, None, None] / HALF
    blobs = torch.exp(-place.square().sum(-1) / (2 * 0.2**2))
    shown = torch.einsum("fnhw,fnd->fndhw", blobs, truth.p * moving).flatten(1, 2)
    return torch.cat([blobs, shown], 1)


def momentum_error(moving):
    truth, unseen = states(256), states(64, 1)
    units = Units.of(truth, HALF)
    frames = units.frames(features(truth, moving), centres(), truth)
    kept = torch.arange(192, 256)
    (probe,) = train_probes(frames[torch.arange(192)], frames[kept], [0], SETTINGS, "test")
    said = units.read(probe, features(unseen, moving), centres())
    return [
        float((said.q - unseen.q).square().mean() / unseen.q.var()),
        float((said.p - unseen.p).square().mean() / unseen.p.var()),
    ]


def test_a_probe_finds_the_momentum_that_features_hold_and_none_where_they_hold_none():
    position, momentum = momentum_error(1.0)
    assert position < 0.05 and momentum < 0.2
    position, momentum = momentum_error(0.0)
    assert position < 0.05 and 0.8 < momentum < 1.5


def test_a_probes_positions_are_the_position_readouts():
    torch.manual_seed(0)
    probe, readout = StateProbe(6, 2), AttentionReadout(6, 2)
    readout.load_state_dict(probe.state_dict(), strict=False)
    values = torch.randn(3, 6, *GRID)
    torch.testing.assert_close(
        probe.read_state(values, centres())[0], readout.read(values, centres())[0]
    )


def test_probes_of_several_seeds_differ_and_are_each_what_they_are_alone():
    truth = states(16)
    frames = Units.of(truth, HALF).frames(features(truth, 1.0), centres(), truth)
    train = (frames, frames[torch.arange(4)])
    quick = FitSettings(3, 8, 1e-2, 1.0)
    both, (alone,) = train_probes(*train, [0, 1], quick, "x"), train_probes(*train, [1], quick, "x")
    a, b, c = (probe.query for probe in (*both, alone))
    assert not torch.allclose(a, b)
    torch.testing.assert_close(b, c)


def test_frames_of_probes_keep_their_momenta_when_they_are_moved_and_cut():
    truth = states(4)
    frames = Units.of(truth, HALF).frames(features(truth, 1.0), centres(), truth)
    some = frames[torch.tensor([2, 0])]
    assert isinstance(some, StateFrames)
    torch.testing.assert_close(some.momenta * Units.of(truth, HALF).momentum, truth.p[[2, 0]])


def test_a_channel_that_is_quiet_in_training_is_not_magnified_without_bound():
    scale = FeatureScale(3)
    values = torch.randn(8, 3, 4, 4)
    values[:, 2] *= 1e-6
    scale.fit(values)
    loud = torch.tensor([0.0, 0.0, 1.0])
    assert float(scale(loud).abs().max()) < 20
    spread = scale(values.movedim(1, -1)).std((0, 1, 2))
    torch.testing.assert_close(spread[:2], torch.ones(2), atol=0.05, rtol=0)


# configurations


def test_repeated_frames_hold_nothing_but_the_labelled_one():
    frames = torch.arange(2 * 5).reshape(2, 5, 1, 1, 1).to(torch.uint8)
    same = temporal_views.repeated(frames, 2)
    assert same.shape == frames.shape
    assert all(bool((same[:, t] == frames[:, 2]).all()) for t in range(5))


def test_disorder_leaves_the_labelled_frame_and_loses_none():
    frames = torch.arange(4 * 16).reshape(4, 16, 1, 1, 1).to(torch.uint8)
    mixed = temporal_views.shuffled(frames, 7)
    torch.testing.assert_close(mixed[:, 7], frames[:, 7])
    torch.testing.assert_close(mixed.sort(1).values, frames)
    assert not torch.equal(mixed, frames)
    orders = {tuple((clip - clip.min()).flatten().tolist()) for clip in mixed}
    assert len(orders) == 4


def test_frames_side_by_side_are_channels_in_their_order():
    values = torch.arange(2 * 3 * 2).reshape(2, 3, 2, 1, 1).float()
    torch.testing.assert_close(side_by_side(values)[0].flatten(), torch.arange(6.0))


class Colours(FrozenEncoder):
    """Mean colours of cells of four pixels; of pairs of frames, for a video encoder."""

    def __init__(self, tubelet):
        identity = {
            "name": "colours",
            "code_version": 1,
            "weights_sha256": "0" * 64,
            "preprocessing": "none",
            "layer": "0",
            "resolution": 32,
        }
        settings = SimpleNamespace(batch=4, dtype="float32")
        windowing = Windowing(16 if tubelet > 1 else 1, tubelet=tubelet, shortens=True)
        super().__init__(torch.nn.Linear(1, 1), settings, windowing, **identity)

    def encode(self, clips, layers=("0",)):
        each = torch.nn.functional.avg_pool2d(clips.flatten(0, 1), 4)
        pairs = each.unflatten(0, clips.shape[:2]).unflatten(1, (-1, self.windowing.tubelet))
        return [pairs.flatten(2, 3)]


@pytest.mark.parametrize(
    ("tubelet", "parts"),
    [
        (2, {"clip", "repeated", "shuffled"}),
        (1, {"single", "differenced", "window", "window-taught-by-differences"}),
    ],
)
def test_a_cell_of_the_table_leaves_records_of_every_seed(monkeypatch, tubelet, parts, tmp_path):
    monkeypatch.setattr(probes, "load_encoder", lambda name, options, device: Colours(tubelet))
    sizes = OracleSizes(1, 1, 1, (1.0,), 1)
    task = CellTask("probes", "i3d", (0, 1), sizes, TINY, folder=tmp_path)
    TABLES["probes"].cells["i3d"](task)
    rows = merged_tables(task.recorders)[0].to_pylist()
    found = {(r["cell"], r["seed"]) for r in rows if r["metric"] == "momentum_nmse"}
    assert found == {(f"i3d/{part}", seed) for part in parts for seed in (0, 1)}
    assert {r["status"] for r in rows} == {"ok"} and {r["encoder"] for r in rows} == {"i3d"}


def test_the_feature_frame_that_is_kept_is_the_labelled_frames():
    frames = torch.zeros(1, 12, 3, 8, 8, dtype=torch.uint8)
    frames[:, 5] = 255
    times = torch.arange(12) * 0.1
    for tubelet in (1, 2):
        kept = temporal_views.OneFrame(Colours(tubelet), 5)(frames, times)
        assert kept.values.shape[1] == 1 and float(kept.values.max()) == 1
    other = temporal_views.OneFrame(Colours(2), 3)
    assert float(other(frames, times).values.max()) == 0
    assert other.identity != temporal_views.OneFrame(Colours(2), 5).identity


class Foresees(Colours):
    """Says of the next frame a share of the way from this one to it; it looks it up."""

    def __init__(self, share):
        super().__init__(1)
        self.share = share
        self.windowing = Windowing(4, shortens=True)

    def see(self, clips):
        (self.whole,) = self.encode(clips)
        return self.whole

    def foresee(self, seen):
        after = self.whole[:, 1 : seen.shape[1] + 1]
        return seen + self.share * (after - seen[:, : after.shape[1]])


@pytest.mark.parametrize(("share", "status"), [(0.5, "ok"), (0.02, "void")])
def test_probes_of_a_predictor_that_foresees_no_more_than_a_copy_are_void(
    monkeypatch, share, status, tmp_path
):
    monkeypatch.setattr(probes, "load_encoder", lambda name, options, device: Foresees(share))
    monkeypatch.setattr(probes, "NO_OPS", ("zero",))
    sizes = OracleSizes(1, 1, 1, (1.0,), 1)
    task = CellTask("probes", "vjepa2-ac", (0,), sizes, TINY, folder=tmp_path)
    TABLES["probes"].cells["vjepa2-ac"](task)
    rows = merged_tables(task.recorders)[0].to_pylist()
    (control,) = [r for r in rows if r["metric"] == "foresight_over_copy"]
    assert control["cell"] == "vjepa2-ac/zero" and control["status"] == "ok"
    assert control["value"] == pytest.approx(1 - share, rel=1e-3)
    probed = [r for r in rows if r["metric"] == "momentum_nmse"]
    assert {r["cell"] for r in probed} == {
        f"vjepa2-ac/zero-{view}" for view in ("clip", "repeated", "shuffled")
    }
    assert {r["status"] for r in probed} == {status}
    assert {r["status"] for r in merged_tables(task.recorders)[1].to_pylist()} == {status}
