"""The rungs over frozen encoders: features once, a trained readout, and skipped without weights."""

from dataclasses import replace

import pytest
import torch

from binders import Tracks
from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.release import WeightsMissing
from renderers import Camera, RgbWorld
from vidphys.cli import main
from vidphys.data.clips import render_clips
from vidphys.data.encounters import EncounterSettings, encounters
from vidphys.errors import InputError
from vidphys.perception import frozen
from vidphys.perception.base import Attentive, FitTask
from vidphys.perception.catalogue import RUNGS
from vidphys.presets import PixelSizes
from vidphys.reading.reader import LoadedEncoder, Reader
from vidphys.runs.folder import RunFolder
from vidphys.scenes import gravity
from vidphys.seeding import derive

SIZES = PixelSizes(24, 9, 40, 32, 40, 32, 0, 4)
WORLD = RgbWorld(Camera(height=32, width=32), radius=0.6)


class Blocks:
    """Colour averaged over blocks of four pixels: features that anybody can check."""

    identity = EncoderIdentity("blocks", 1, "0" * 64, "none", "0", 32, "float32")

    def __init__(self):
        self.clips = 0

    def __call__(self, frames, times, progress=None):
        self.clips += len(frames)
        light = frames.float().flatten(0, 1) / 255
        values = torch.nn.functional.avg_pool2d(light, 4)
        return FeatureMap(values.unflatten(0, frames.shape[:2]), (4.0, 4.0), times)


def perceiving(encoder, readout):
    """Three bodies, read from clips of eight world units."""
    reader = Reader(LoadedEncoder("blocks", {}, encoder), readout, 3, 4.0)
    return frozen.FrozenPerception(reader, None)


class Pairs(Blocks):
    """One feature frame for two frames of the clip, their channels side by side."""

    def __call__(self, frames, times, progress=None):
        each = super().__call__(frames, times)
        two = each.values.unflatten(1, (-1, 2)).flatten(2, 3)
        return FeatureMap(two, each.stride, times.unflatten(0, (-1, 2)).mean(1))


@pytest.fixture
def encoder(monkeypatch):
    blocks = Blocks()
    monkeypatch.setattr(frozen, "load_encoder", lambda name, options, device: blocks)
    return blocks


@pytest.fixture(scope="module")
def clips():
    return render_clips(gravity(mass=(1.0, 1.0)), WORLD, 24, 9, 40, 0, "train")


def test_the_readout_learns_where_bodies_are_and_features_are_made_once(encoder, clips, tmp_path):
    task = FitTask(clips, SIZES, 0, "factored", tmp_path)
    perception = frozen.fit_frozen("blocks", {}, task)
    assert encoder.clips == len(clips)
    tracks = perception.tracks(clips)
    assert encoder.clips == len(clips)
    assert tracks.positions.shape == clips.states.q.shape
    error = (tracks.positions - clips.states.q).norm(dim=-1)
    nowhere = clips.states.q.norm(dim=-1)
    assert float(error.median()) < 0.2 * float(nowhere.median())
    shares, grid = perception.attention(clips.first(1)), Blocks()(clips.frames, clips.times)
    assert shares.shape == (9, 3, 8, 8)
    looked = 4 * torch.einsum("tnhw,hwd->tnd", shares, grid.cell_centres())
    assert float((looked - clips.states.q[0]).norm(dim=-1).mean()) < 0.8 * float(
        clips.states.q[0].norm(dim=-1).mean()
    )
    unseen = render_clips(gravity(mass=(1.0, 1.0)), WORLD, 4, 7, 40, 0, "test")
    perception.tracks(unseen)
    assert encoder.clips == len(clips) + 1 + len(unseen)


@pytest.mark.slow
def test_a_video_encoders_feature_frame_tells_where_bodies_are_in_each_of_its_frames(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(frozen, "load_encoder", lambda name, options, device: Pairs())
    clips = render_clips(gravity(mass=(1.0, 1.0)), WORLD, 24, 8, 40, 0, "train")
    perception = frozen.fit_frozen("pairs", {}, FitTask(clips, SIZES, 0, "factored", tmp_path))
    tracks = perception.tracks(clips)
    error = (tracks.positions - clips.states.q).norm(dim=-1)
    assert float(error.median()) < 0.2 * float(clips.states.q.norm(dim=-1).median())


def test_what_is_read_of_a_feature_frame_goes_to_its_own_frames_and_bodies():
    clips = render_clips(gravity(mass=(1.0, 1.0)), WORLD, 3, 8, 40, 0, "train")

    class Telling(Blocks):
        """Its features are the true positions of two frames and three bodies."""

        def __call__(self, frames, times, progress=None):
            values = (clips.states.q / 4.0).float().unflatten(1, (-1, 2)).flatten(2)
            return FeatureMap(values[..., None, None], (32.0, 32.0), times[::2])

    class Reading:
        def read(self, values, centres):
            positions = values.float().reshape(len(values), 6, 2)
            return positions, positions[..., 0].sigmoid()

    tracks = perceiving(Telling(), Reading()).tracks(clips)
    torch.testing.assert_close(tracks.positions, clips.states.q, atol=4e-3, rtol=0)
    sure = (clips.states.q[..., 0] / 4).sigmoid()
    torch.testing.assert_close(tracks.confidence, sure, atol=1e-3, rtol=0)


def test_a_number_of_frames_that_feature_frames_do_not_divide_is_refused(monkeypatch, clips):
    class Uneven(Blocks):
        def __call__(self, frames, times, progress=None):
            each = super().__call__(frames, times)
            return FeatureMap(each.values[:, :4], each.stride, times[:4])

    monkeypatch.setattr(frozen, "load_encoder", lambda name, options, device: Uneven())
    with pytest.raises(InputError, match="9 frames a clip give 4 feature frames"):
        frozen.fit_frozen("uneven", {}, FitTask(clips, SIZES, 0, "factored"))


def test_without_a_folder_nothing_is_kept(encoder, clips):
    few = replace(clips, frames=clips.frames[:2], states=clips.states[:2], params=clips.params[:2])
    features = frozen.encode_clips(encoder, few, None)
    assert features.values.shape == (2, 9, 3, 8, 8)
    want = few.frames.float().flatten(0, 1) / 255
    want = torch.nn.functional.avg_pool2d(want, 4).unflatten(0, (2, 9))
    torch.testing.assert_close(features.values.float(), want, atol=1e-3, rtol=0)


def test_one_clip_is_too_few(encoder, clips):
    one = replace(clips, frames=clips.frames[:1], states=clips.states[:1], params=clips.params[:1])
    with pytest.raises(InputError, match="1 training clips"):
        frozen.fit_frozen("blocks", {}, FitTask(one, SIZES, 0, "factored"))


def test_without_weights_the_rung_says_which_command_gets_them(clips, tmp_path, monkeypatch):
    monkeypatch.setenv("VIDPHYS_WEIGHTS", str(tmp_path))
    with pytest.raises(WeightsMissing, match="vidphys weights fetch hiera"):
        RUNGS["hiera"].fit(FitTask(clips, SIZES, 0, "factored"))


def test_a_ladder_without_weights_skips_the_rung_and_succeeds(tmp_path, monkeypatch, capsys):
    """The error crosses from the worker; the run says why, and is not a failed run."""
    monkeypatch.setattr("vidphys.runs.pool.run_all", _absent)
    run = tmp_path / "run"
    parts = RunFolder(run)
    monkeypatch.setattr(RunFolder, "join", lambda self: None)
    monkeypatch.setattr("vidphys.cli.ladder.publish", lambda run, console: run.path)
    assert main(["ladder", "--cells", "hiera", "--out", str(run), "--quiet"]) == 0
    assert parts.manifest()["skipped"] == [
        {"cell": f"ladder/hiera/{head}", "reason": "skipped: no weights; fetch them"}
        for head in ("factored", "unstructured")
    ]
    said = capsys.readouterr().err
    assert said == "warning: hiera skipped: no weights; fetch them\n"  # once, not for each cell


def _absent(work, tasks, workers, show, finished, cards):
    return [(0, WeightsMissing("no weights; fetch them"))]


def test_bodies_of_an_encounter_move_as_in_clips_and_meet_in_the_frame(clips):
    made = encounters(clips, 100, 5, 0)
    steps = made.states.q.diff(dim=1)
    known = clips.states.q.diff(dim=1).unfold(1, 4, 1).movedim(-1, 2).flatten(0, 1)
    for body in range(3):
        apart = (steps[:, None, :, body] - known[None, ..., body, :]).abs().amax((-2, -1))
        assert float(apart.amin(1).max()) < 1e-12
    moved = (made.states.q[:, :1, None] - clips.states.q).norm(dim=-1)
    assert float(moved.amin((1, 2, 3)).max()) < 1e-12  # one of them stays where it was
    wide = replace(clips, states=clips.states.map(lambda x: 4.0 * x / clips.states.q.abs().max()))
    assert float(encounters(wide, 400, 5, 0).states.q.abs().max()) <= 4.0 + 1e-12
    met, usual = (
        (torch.cdist(q, q) + 9 * torch.eye(3)).amin((-2, -1)) < EncounterSettings().near * 4.0
        for q in (encounters(clips, 400, 1, 0).states.q, clips.states.q)
    )
    assert float(met.double().mean()) > 0.85
    assert float(usual.double().mean()) < 0.7
    drawn = (WORLD(made.states.q[7].float()) * 255).round().to(torch.uint8)
    assert torch.equal(made.frames[7], drawn)


def test_encounters_are_as_long_as_the_encoder_needs(monkeypatch, clips):
    """So many clips' worth of frames, of which each, or each few, are another encounter."""
    few = replace(clips, frames=clips.frames[:, :8], states=clips.states[:, :8])
    sizes = replace(SIZES, encounters=5, perception_steps=2)
    for encoder, together, extra in (
        (Blocks(), 1, 40),
        (Blocks(), None, 5),
        (Pairs(), 4, 10),
        (Pairs(), None, 5),
    ):
        trained = []
        monkeypatch.setattr(
            frozen, "_train", lambda name, x, *rest, t=trained: t.append(x) or Still()
        )
        task = FitTask(few, sizes, 0, "factored")
        frozen.fit_readout(LoadedEncoder("blocks", {}, encoder), task, together=together)
        assert encoder.clips == len(clips) + extra
        frames = 8 * 3 // trained[0].train.targets.shape[1]
        assert len(trained[0].train) == (21 + 5) * frames
        assert len(trained[0].held_out) == 3 * frames


class Still(torch.nn.Module):
    """Stands for a trained readout."""


def test_mirror_images_are_read_where_they_are_and_their_errors_average_out():
    clips = render_clips(gravity(mass=(1.0, 1.0)), WORLD, 3, 8, 40, 0, "train")

    class Leaning:
        """The middle of the red light, read too far to the right and above, in any picture."""

        def read(self, values, centres):
            light = values[:, 0].float()
            middle = torch.einsum("fhw,hwd->fd", light, centres) / light.sum((1, 2))[:, None]
            return (middle + 0.1)[:, None].expand(-1, 3, -1), torch.full((len(values), 3), 0.25)

    perception = perceiving(Blocks(), Leaning())
    assert isinstance(perception, Attentive)
    once, closely = perception.tracks(clips), perception.closely(clips)
    torch.testing.assert_close(closely.positions, once.positions - 0.4, atol=1e-3, rtol=0)
    torch.testing.assert_close(closely.confidence, once.confidence)


def test_an_anchored_readout_learns_from_a_tracker_and_reads_no_state(monkeypatch):
    monkeypatch.setattr(frozen, "load_encoder", lambda name, options, device: Blocks())
    monkeypatch.setattr(frozen, "encounters", None)  # no clip is made of true paths
    clips = render_clips(gravity(mass=(1.0, 1.0)), WORLD, 24, 8, 40, 0, "train")
    states = clips.states.map(lambda x: torch.full_like(x, torch.nan))
    blind, sizes = replace(clips, states=states), replace(SIZES, encounters=8)
    task = FitTask(blind, sizes, 0, "factored")
    perception = frozen.fit_frozen("blocks", {}, task, anchored=True)
    error = (perception.tracks(clips).positions - clips.states.q).norm(dim=-1)
    assert float(error.median()) < 0.2 * float(clips.states.q.norm(dim=-1).median())


def test_controls_are_what_they_are_called(monkeypatch, clips):
    """Random weights and pooling: what a rung is compared with is not the rung itself."""
    loaded, fitted = [], []
    monkeypatch.setattr(frozen, "load_encoder", lambda _, options, device: loaded.append(options))
    monkeypatch.setattr(frozen, "fit_readout", lambda *given: fitted.append(given))
    task = FitTask(clips, SIZES, 5, "factored")
    for random in (False, True):
        frozen.fit_frozen("blocks", {"side": 8}, task, pooled=True, random=random)
    assert loaded == [{"side": 8}, {"side": 8, "seed": derive(5, "weights", "blocks")}]
    assert [given[2] for given in fitted] == [True, True]


@pytest.mark.parametrize("pooled", [False, True])
def test_a_pooled_readout_is_told_the_mean_over_the_cells_alone(pooled, encoder, clips):
    short = replace(SIZES, perception_steps=1, perception_batch=4)
    few = clips.first(4)
    perception = frozen.fit_frozen("blocks", {}, FitTask(few, short, 0, "factored"), pooled=pooled)
    values = encoder(few.frames[:1], few.times).values[0]
    centres = torch.rand(*values.shape[-2:], 2)
    shuffled = values.flatten(2)[..., torch.randperm(values[0, 0].numel())].reshape(values.shape)
    one, other = (perception.reader.readout.read(x, centres)[0] for x in (values, shuffled))
    assert torch.allclose(one, other, atol=1e-5) == pooled


def test_a_hidden_body_counts_by_as_much_as_is_seen_of_it():
    clips = render_clips(gravity(mass=(1.0, 1.0)), WORLD, 3, 8, 40, 0, "train")
    features = Blocks()(clips.frames, clips.times)
    sure = torch.rand(clips.states.q.shape[:-1], generator=torch.Generator().manual_seed(0))
    tracks = Tracks(clips.states.q + 1, sure, clips.times)
    told, plain = frozen.labelled(clips, features, tracks), frozen.labelled(clips, features)
    shift = 1 / clips.world.camera.half_extent
    assert torch.allclose(told.targets, plain.targets + shift, atol=1e-6)
    assert torch.equal(told.weight, sure.flatten(0, 1)) and bool((plain.weight == 1).all())
