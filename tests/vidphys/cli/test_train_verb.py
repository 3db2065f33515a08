"""`vidphys train` and `rollout`: resumed bit for bit, rebuilt the same, refused in one line."""

from __future__ import annotations

import json
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from torch import Tensor

from binders.base import Binder
from binders.tracks import Tracks
from encoders.store import FeatureStore
from readouts.base import FrameReadout
from readouts.kinds import MapShape, ReadoutKind
from readouts.local import RefinedReadout
from tests.shared.small_clips import (
    RATE,
    SIDE,
    cells,  # noqa: F401
    know_cells,
    pictures,
    swing,
    write_clip,
)
from vidphys.cli import main
from vidphys.data.rendered import write_video
from vidphys.data.video import ClipSelection, open_video
from vidphys.reading import clip_dynamics
from vidphys.reading import pipeline as pipeline_module
from vidphys.reading.pipeline import load_pipeline
from vidphys.reading.reader import Reader
from vidphys.runs import checkpoint
from vidphys.shooting import step
from vidphys.training import learner

CLIPS, FRAMES = 3, 20
QUICK = ["--encoder", "cells", "--steps", "12", "--head-steps", "4", "--shift", "1"]
PLAIN = ["--readout", "attention"]
LEARN = [*PLAIN, "--steps", "250", "--learning-rates", "0.01", "--widths", "32"]


def coarse(patch: pytest.MonkeyPatch) -> None:
    """Few model steps a frame, and short windows: how good heads become is tested elsewhere."""
    patch.setattr(step, "HEAD_DT", 0.05)
    patch.setattr(clip_dynamics, "AHEAD", {"curve": 2, "plane": 1})


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    coarse(monkeypatch)


def write_folder(root: Path) -> Path:
    for k in range(CLIPS):
        write_clip(root / "mine" / f"clip{k}.avi", FRAMES, phase=k)
    return root / "mine"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path)


@pytest.fixture(scope="module")
def saved() -> list[pipeline_module.Pipeline]:
    """The pipeline of the finished run, as it was when it was written."""
    return []


@pytest.fixture(scope="module")
def trained(
    tmp_path_factory: pytest.TempPathFactory, saved: list[pipeline_module.Pipeline]
) -> tuple[Path, Path]:
    """A finished run, and a clip that it was not trained on."""
    real = pipeline_module.save_pipeline

    def keep(folder: Path, pipeline: pipeline_module.Pipeline) -> None:
        saved.append(pipeline)
        real(folder, pipeline)

    root = tmp_path_factory.mktemp("trained")
    write_folder(root)
    write_clip(root / "new.avi", FRAMES, phase=0.5, table=False)
    with pytest.MonkeyPatch.context() as patch:
        know_cells(patch)
        coarse(patch)
        patch.setattr(pipeline_module, "save_pipeline", keep)
        assert train(root / "mine", root / "run") == 0
    return root / "run", root / "new.avi"


def train(data: Path, out: Path, *more: str) -> int:
    store = ["--store", str(out.parent / "features"), "--out", str(out), "--quiet"]
    return main(["train", str(data), *QUICK, *store, *more])


def rollout(run: Path, clip: Path, out: Path, *more: str) -> int:
    return main(["rollout", str(run), str(clip), "--out", str(out), "--quiet", *more])


def weights(run: Path) -> dict[str, torch.Tensor]:
    return checkpoint.load(run / "checkpoints" / "pipeline.json")[0]


def test_features_in_eight_bits_are_read_where_they_lie(folder, monkeypatch):
    know_cells(monkeypatch)
    coarse(monkeypatch)
    store = folder.parent / "features"
    eight = ["--store-dtype", "int8"]
    assert main(["extract", str(folder), "--encoder", "cells", *eight, "--out", str(store)]) == 0
    before = [entry["request"] for entry in FeatureStore(store).entries()]
    assert {request["dtype"] for request in before} == {"int8"} and len(before) == CLIPS
    assert train(folder, folder.parent / "run", *eight, "--no-mirrors") == 0
    assert [entry["request"] for entry in FeatureStore(store).entries()] == before


def records(run: Path) -> dict[tuple[str, str], float]:
    rows = pq.read_table(run / "records.parquet").to_pylist()
    return {(row["cell"], row["metric"]): row["value"] for row in rows}


def missed(reader: Reader, clip: Path) -> float:
    """Root mean squared distance, pixels, in the third clip of a folder."""
    video = open_video(clip, ClipSelection())
    seen = reader.read(video.frames, video.times).positions[0, :, 0].numpy()
    truth = (swing(FRAMES, 2)[:, 0] + 0.5 - 16) / 16 * [1, -1]
    return float(np.sqrt(((seen - truth) ** 2).sum(-1).mean())) * 16


class Brightest(FrameReadout):
    """Somebody's: the middle of the redness, whose contrast is learned."""

    def __init__(self, shape: MapShape) -> None:
        super().__init__()
        self.contrast = torch.nn.Parameter(torch.tensor(30.0))

    def read(self, values: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
        heat = (self.contrast * (values[:, 0] - values[:, 1]).float()).flatten(1).softmax(-1)
        place = (heat @ centres.flatten(0, 1))[:, None]
        return place, torch.full_like(place[..., 0], 0.5)


BRIGHTEST = ReadoutKind(Brightest)


def reddest(bodies: int) -> Binder:
    """Somebody's: the middle of what is redder than it is green, of one body."""
    assert bodies == 1
    up = np.array([1.0, -1.0])
    places = (np.mgrid[:SIDE, :SIDE][::-1].transpose(1, 2, 0) + 0.5 - SIDE / 2) / (SIDE / 2) * up

    def follow(frames: np.ndarray, times: np.ndarray) -> Tracks:
        red = np.clip(frames[..., 0].astype(float) - frames[..., 1], 0, None)
        middle = np.einsum("thw,hwd->td", red, places) / red.sum((1, 2))[:, None]
        positions = torch.from_numpy(middle)[None, :, None].float()
        return Tracks(positions, torch.ones(positions.shape[:-1]), torch.from_numpy(times))

    return follow


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    err = capsys.readouterr().err.strip()
    assert err.startswith("error: ") and "\n" not in err
    return err


@pytest.mark.usefixtures("cells")
class TestTraining:
    def test_a_folder_with_tables_is_learned_and_whole_clips_are_held_out(
        self, folder: Path, tmp_path: Path
    ) -> None:
        run = tmp_path / "run"
        assert train(folder, run, *LEARN) == 0
        found = records(run)
        assert found["readout/attention", "readout_rmse_pixels"] < 1.3
        pooled = found["readout/pooled", "readout_rmse_pixels"]
        assert found["readout/attention", "readout_rmse_pixels"] < pooled / 2
        reader = load_pipeline(run).reader
        assert not reader.follows_camera and reader.bodies == 1
        assert missed(reader, folder / "clip2.avi") < 1.3
        episodes = pq.read_table(run / "episodes.parquet").to_pylist()
        assert {row["episode"] for row in episodes} == {0}  # the last of the clips is scored
        assert (run / "recordings" / "clip.rrd").is_file()

    @pytest.mark.slow
    def test_by_default_positions_are_read_twice_and_in_mirrors(
        self, folder: Path, tmp_path: Path
    ) -> None:
        run = tmp_path / "run"
        assert train(folder, run, "--steps", "540", "--batch", "32", "--readers", "1", "2") == 0
        found = records(run)
        errors = {cell for cell, metric in found if metric == "held_out_error_normalised"}
        kinds = [f"readout/{kind}-readers{n}" for kind in ("pooled", "refined") for n in (1, 2)]
        assert errors == {f"{kind}-rate0.003-seed0" for kind in kinds}
        twice = found["readout/refined", "readout_rmse_pixels"]
        assert twice < 0.7 and twice < found["readout/pooled", "readout_rmse_pixels"] / 3
        reader = load_pipeline(run).reader
        assert isinstance(reader.readout, RefinedReadout) and reader.mirrors
        once = missed(replace(reader, mirrors=False), folder / "clip2.avi")
        assert missed(reader, folder / "clip2.avi") < once < 0.7

    def test_a_readout_from_outside_is_trained_and_rebuilt_by_its_path(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run, kind = tmp_path / "run", f"{__name__}:BRIGHTEST"
        assert train(folder, run, "--readout", kind, "--steps", "100") == 0
        assert records(run)[f"readout/{kind}", "readout_rmse_pixels"] < 2.0
        assert type(load_pipeline(run).reader.readout) is Brightest
        sources = json.loads((run / "run.json").read_text())["settings"]["sources"]
        assert sources[f"readout {kind}"].split()[0] == __name__
        assert train(folder, tmp_path / "no", "--readout", kind, "--readers", "2") == 2
        assert f"--readers: would have no effect: --readout {kind} takes none" in one_line(capsys)

    @pytest.mark.parametrize(
        "cut",
        [
            pytest.param(1, marks=pytest.mark.slow),
            326,
            *(pytest.param(x, marks=pytest.mark.slow) for x in (5, 100, 317)),
        ],
    )
    def test_an_interrupted_training_ends_with_the_same_bits(
        self,
        trained: tuple[Path, Path],
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        cut: int,
    ) -> None:
        """Cut in the parts of the readout, in the pooled one, and in a head."""
        whole, folder = trained[0], trained[0].parent / "mine"
        real, count = learner.Learner.update, [0]

        def cutting(self: learner.Learner, batch: object) -> None:
            count[0] += 1
            if count[0] == cut:
                signal.raise_signal(signal.SIGINT)
            real(self, batch)

        monkeypatch.setattr(learner.Learner, "update", cutting)
        assert train(folder, tmp_path / "cut") == 130
        assert count[0] == cut and not (tmp_path / "cut" / "records.parquet").exists()
        assert train(folder, tmp_path / "cut") == 0
        once, again = weights(whole), weights(tmp_path / "cut")
        assert once.keys() == again.keys() and len(once) > 20
        assert all(torch.equal(once[k], again[k]) for k in once)
        assert records(whole) == records(tmp_path / "cut")

    def test_a_run_that_was_killed_while_it_drew_is_drawn_by_the_same_command(
        self, trained: tuple[Path, Path], tmp_path: Path
    ) -> None:
        whole, run = trained[0], tmp_path / "run"
        folder = whole.parent / "mine"
        shutil.copytree(whole, run)
        for drawn in ("recordings", "figures"):
            shutil.rmtree(run / drawn)
        assert train(folder, run) == 0
        assert (run / "recordings" / "clip.rrd").exists()
        drawn = Path("figures", "clip.svg")
        assert (run / drawn).read_bytes() == (whole / drawn).read_bytes()
        assert records(whole) == records(run)

    def test_a_finished_run_is_shown_again_and_another_one_refused(
        self, trained: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run, folder = tmp_path / "run", tmp_path / "mine"
        shutil.copytree(trained[0], run)
        shutil.copytree(trained[0].parent / "mine", folder)
        pipeline = (run / "checkpoints" / "pipeline.json").stat().st_mtime_ns
        assert train(folder, run) == 0
        assert "readout/refined" in capsys.readouterr().out
        assert (run / "checkpoints" / "pipeline.json").stat().st_mtime_ns == pipeline
        assert train(folder, run, "--seed", "1") == 2
        assert "--overwrite" in one_line(capsys)
        (folder / "clip0.csv").write_text((folder / "clip1.csv").read_text())
        assert train(folder, run) == 2  # the labels are part of what the run is
        assert "--overwrite" in one_line(capsys)

    @pytest.mark.slow
    def test_many_readouts_are_all_recorded_and_the_best_is_kept(
        self, folder: Path, tmp_path: Path
    ) -> None:
        run = tmp_path / "run"
        grid = ["--widths", "8", "16", "--learning-rates", "0.01", "0.0001", "--seeds", "2"]
        assert train(folder, run, *PLAIN, *grid, "--layers", "4", "8") == 0
        errors = {
            cell.removeprefix("readout/"): value
            for (cell, metric), value in records(run).items()
            if metric == "held_out_error_normalised"
        }
        attention = {k: v for k, v in errors.items() if k.startswith("attention")}
        assert len(errors) == 2 * 16 and len(attention) == 16
        best = min(attention, key=attention.__getitem__)
        meta = checkpoint.load(run / "checkpoints" / "pipeline.json")[1]
        assert f"-width{meta['readout']['sizes']['width']}-" in best
        assert f"-layer{meta['encoder']['options']['layer']}-" in best
        manifest = json.loads((run / "run.json").read_text())
        assert len(manifest["settings"]["identities"]) == 2

    def test_early_stopping_stops(self, folder: Path, tmp_path: Path) -> None:
        run = tmp_path / "run"
        # a rate at which nothing gets better
        more = ["--patience", "3", "--learning-rates", "3", "--steps", "30"]
        assert train(folder, run, *PLAIN, *more) == 0
        name = "readout/attention-width128-rate3-seed0"
        found = records(run)
        assert found[name, "steps"] == found[name, "kept_step"] + 3 < 30

    def test_a_single_clip_is_followed_by_what_moves_and_cut_in_time(self, tmp_path: Path) -> None:
        clip, run = tmp_path / "one.avi", tmp_path / "run"
        write_clip(clip, 80, table=False)
        assert train(clip, run, *LEARN) == 0
        found = records(run)
        assert found["readout/attention", "readout_rmse_pixels"] < 0.8
        pipeline = load_pipeline(run)
        assert pipeline.reader.follows_camera and pipeline.dynamics.chart.kind == "curve"
        assert found["clip/factored", "friction_per_second"] > 0

    def test_a_binder_from_outside_labels_a_clip_and_takes_no_shadow(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        clip, run, more = (
            tmp_path / "one.avi",
            tmp_path / "run",
            ("--binder", f"{__name__}:reddest"),
        )
        write_clip(clip, 80, table=False)
        assert train(clip, tmp_path / "no", *more, "--shadow", "1") == 2
        assert "--shadow: would have no effect: --binder" in one_line(capsys)
        assert train(clip, run, *more, *LEARN) == 0
        assert records(run)["readout/attention", "readout_rmse_pixels"] < 0.8
        rows = pq.read_table(run / "records.parquet").to_pylist()
        assert {row["binder"] for row in rows} == {more[1]}
        assert not load_pipeline(run).reader.follows_camera

    def test_a_video_encoders_feature_frame_is_read_at_each_of_its_frames(
        self, folder: Path, tmp_path: Path
    ) -> None:
        run = tmp_path / "run"  # 20 frames are no multiple of 3
        assert train(folder, run, "--frames", "3", *LEARN) == 0
        assert records(run)["readout/attention", "readout_rmse_pixels"] < 2.0
        shape = checkpoint.load(run / "checkpoints" / "pipeline.json")[1]["readout"]["shape"]
        assert (shape["bodies"], shape["frames"]) == (1, 3)

    def test_rendered_clips_have_a_pair_law_and_no_friction(self, tmp_path: Path) -> None:
        data, run = tmp_path / "gravity", tmp_path / "run"
        size = ["--clips", "3", "--frames", "6", "--image", "16", "--quiet"]
        assert main(["render", "--out", str(data), *size]) == 0
        assert train(data, run) == 0
        found = records(run)
        assert ("clip/factored", "forecast_rmse_normalised") in found
        assert ("clip/factored", "friction_per_second") not in found
        pipeline = load_pipeline(run)
        assert pipeline.dynamics.chart.kind == "plane" and pipeline.reader.half_extent == 4.0
        assert type(pipeline.dynamics.heads["factored"].potential).__name__.startswith("Displ")


@pytest.mark.usefixtures("cells")
class TestRollout:
    def test_a_rebuilt_pipeline_gives_identical_outputs(
        self, trained: tuple[Path, Path], saved: list[pipeline_module.Pipeline]
    ) -> None:
        run, clip = trained
        (original,) = saved
        rebuilt = load_pipeline(run)
        video = open_video(clip, ClipSelection())
        for head in ("factored", "unstructured"):
            one, two = (p(video.frames, video.times, head=head) for p in (original, rebuilt))
            assert torch.equal(one.tracks.positions, two.tracks.positions)
            assert torch.equal(one.tracks.confidence, two.tracks.confidence)
            assert torch.equal(one.state.flat, two.state.flat)
            assert torch.equal(one.rollout.positions, two.rollout.positions)
            assert one.rollout.positions.shape[1:] == (1, 2)
            assert one.flags == two.flags
            assert [flag.name for flag in one.flags] == ["features", "doubt", "physics"]

    def test_a_pipeline_of_an_older_version_reads_as_it_did(
        self, folder: Path, tmp_path: Path
    ) -> None:
        """Its readout was attention, without a word of that, and it read no mirrors."""
        run, clip = tmp_path / "run", open_video(folder / "clip0.avi", ClipSelection())
        assert train(folder, run, *PLAIN, "--widths", "8", "--no-mirrors") == 0
        now = load_pipeline(run).reader.read(clip.frames, clip.times)
        path = run / "checkpoints" / "pipeline.json"
        tensors, meta = checkpoint.load(path)
        del meta["mirrors"], meta["familiar"]
        old = {**meta, "readout": {"channels": 3, "bodies": 1, "width": 8}}
        checkpoint.save(path, tensors, old)
        pipeline = load_pipeline(run)
        reader = pipeline.reader
        assert torch.equal(reader.read(clip.frames, clip.times).positions, now.positions)
        assert pipeline(clip.frames, clip.times).flags == ()
        assert not reader.mirrors

    def test_a_clip_of_another_kind_is_said_to_be_one(
        self, trained: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run, clip = trained
        other, told = tmp_path / "other.avi", {}
        write_video(other, 255 - pictures(swing(FRAMES, 0.5)), RATE)
        for name, shown in (("same", clip), ("other", other)):
            assert rollout(run, shown, tmp_path / name) == 0
            warned = capsys.readouterr().err
            flags = json.loads((tmp_path / name / "run.json").read_text())["flags"]
            told[name] = "unlike those of the training: what the encoder sees lies" in warned
            assert flags["features"]["raised"] == told[name]
        assert told == {"same": False, "other": True}

    def test_a_changed_law_changes_the_rollout(
        self, trained: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run, clip = trained
        asked = (
            ("flip", "--coupling", "-1"),
            ("free", "--law", "friction=0"),
            ("same", "--coupling=1"),
        )
        apart = {}
        for name, *more in asked:
            assert rollout(run, clip, tmp_path / name, *more) == 0
            ran = json.loads((tmp_path / name / "run.json").read_text())["rolled"]
            assert list(ran) == ["the law that held", "the changed law"]
            for each in ran.values():
                assert each["spline"] is None and "too few for a spline" in each["why"]
            with np.load(tmp_path / name / "rollout.npz") as found:
                assert found["times"].shape == (FRAMES,) and found["track"].shape == (FRAMES, 1, 2)
                np.testing.assert_array_equal(found["rollout"][0], found["changed"][0])
                assert found["rollout_times"][0] == found["times"][-1]
                length = found["rollout_times"][-1] - found["times"][-1]
                assert length == pytest.approx(3.0, abs=0.02)
                apart[name] = float(np.abs(found["rollout"] - found["changed"]).max())
            recording = (tmp_path / name / "recordings" / "rollout.rrd").read_bytes()
            assert b"/video/attention" in recording
        assert apart["flip"] > 0.01 and apart["free"] > 1e-5 and apart["same"] == 0
        assert "the changed law" in capsys.readouterr().out

    def test_the_unstructured_head_rolls_but_has_no_friction(
        self, trained: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run, clip = trained
        twin = ["--head", "unstructured"]
        assert (
            rollout(run, clip, tmp_path / "a", *twin, "--beyond", "0.3", "--reach", "0", "0") == 0
        )
        with np.load(tmp_path / "a" / "rollout.npz") as found:
            away = [np.linalg.norm(found[name][-1]) for name in ("rollout", "changed")]
        assert away[1] < away[0]  # the picture's middle is where it was to be pushed
        assert rollout(run, clip, tmp_path / "b", *twin, "--law", "friction=0") == 2
        assert (
            "--law friction: this model has no such number; it has mass" in capsys.readouterr().err
        )
        assert not (tmp_path / "b").exists()

    def test_other_weights_are_refused(
        self,
        trained: tuple[Path, Path],
        cells: dict[str, str],  # noqa: F811
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        cells["sha256"] = "f" * 64
        assert rollout(*trained, tmp_path / "r") == 2
        assert "trained over cells with weights_sha256 0000" in one_line(capsys)

    def test_wrong_input(
        self, trained: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run, clip = trained
        for arguments, words in (
            ((tmp_path, clip), "no folder of `vidphys train`"),
            ((run, tmp_path / "none.avi"), "no such file"),
            ((run, clip, "--beyond", "0"), "must be above 0"),
            ((run, clip, "--stop", "4"), "start state needs three"),
            ((run, clip, "--rate", "7"), "frames per second do not meet"),
        ):
            assert rollout(arguments[0], arguments[1], tmp_path / "out", *arguments[2:]) == 2
            assert words in one_line(capsys)
            assert not (tmp_path / "out").exists()

    def test_another_rollout_is_not_overwritten(
        self, trained: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = tmp_path / "r"
        assert rollout(*trained, out) == 0
        capsys.readouterr()
        assert rollout(*trained, out, "--beyond", "1") == 2
        assert "--overwrite" in one_line(capsys)
        assert rollout(*trained, out, "--beyond", "1", "--overwrite") == 0


@pytest.mark.usefixtures("cells")
class TestWrongInput:
    @pytest.mark.parametrize(
        ("more", "words"),
        [
            ([*PLAIN, "--widths", "30"], "--widths 30: must be a multiple of 4"),
            (["--widths", "32"], "--widths: would have no effect: --readout refined takes none"),
            ([*PLAIN, "--readers", "2"], "--readers: would have no effect: --readout attention"),
            (["--readers", "0"], "--readers 0: must be at least 1"),
            (["--readout", "pooled"], "--shift: would have no effect: --readout pooled"),
            (["--readout", "refind"], "did you mean 'refined'"),
            (["--readout", "nobody:x"], "--readout nobody:x: readout 'nobody:x'"),
            (["--bodies", "2"], "--bodies: would have no effect: the tables of"),
            (["--shadow", "0.6"], "--shadow: would have no effect: the tables of"),
            (["--learning-rates", "0"], "--learning-rates 0.0: must be above 0"),
            (["--seeds", "0"], "--seeds 0: must be at least 1"),
            (["--patience", "-1"], "--patience -1: must be at least 0"),
            (["--train-share", "1"], "leaves 3 of 3 clips"),
            (["--encoder", "cels"], "unknown encoder 'cels'; did you mean 'cells'"),
            (["--encoder", "hiera"], "vidphys weights fetch hiera"),
            (["--hop", "2"], "cells: takes no hop"),
            (["--frames", "50"], "20 frames, but a feature frame of cells stands for 50"),
            (["--stop", "2"], "momentum needs at least 3 frames"),
        ],
    )
    def test_options(
        self,
        folder: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        more: list[str],
        words: str,
    ) -> None:
        monkeypatch.setenv("VIDPHYS_WEIGHTS", str(tmp_path))
        assert train(folder, tmp_path / "run", *more) == 2
        assert words in one_line(capsys)
        assert not (tmp_path / "run").exists()

    def test_data(self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "empty").mkdir()
        self._refused(tmp_path / "empty", capsys, "no clips")
        self._refused(tmp_path / "none", capsys, "no such file or folder")
        table = (folder / "clip1.csv").read_text()
        for text, words in (
            (table.rsplit("\n", 2)[0], "19 rows, but clip1.avi has frames up to number 19"),
            ("a,b\n1,2\n", "no coordinates among the columns a, b"),
            (
                table.replace("u1,v1", "u1,v1,time"),
                "2 numbers in a row, but 3 names: u1, v1, time",
            ),
            ("u1,v1,u2,v2\n" + "1,2,3,4\n" * FRAMES, "number of bodies 2, but clip0.avi has 1"),
            ("u1,v1\n" + ",\n" * FRAMES, "no rows of numbers"),
        ):
            (folder / "clip1.csv").write_text(text)
            self._refused(folder, capsys, words)
        (folder / "clip1.csv").unlink()
        self._refused(folder, capsys, "1 of 3 clips have no labels")
        write_clip(folder / "clip1.avi", FRAMES)
        places = swing(FRAMES, 0)
        write_video(folder / "clip1.avi", pictures(places)[:, :30], RATE)
        self._refused(folder, capsys, "frame size (30, 32), but clip0.avi has (32, 32)")
        write_video(folder / "clip1.avi", pictures(places), 2 * RATE)
        self._refused(folder, capsys, "50 frames per second, but clip0.avi has 25")

    @staticmethod
    def _refused(data: Path, capsys: pytest.CaptureFixture[str], words: str) -> None:
        run = data.parent / "refused"
        assert train(data, run) == 2
        assert words in one_line(capsys)
        assert not run.exists()

    def test_bodies_that_look_alike(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        data = tmp_path / "alike"
        size = ["--clips", "3", "--frames", "4", "--image", "16", "--world", "anonymous"]
        assert main(["render", "--out", str(data), *size, "--quiet"]) == 0
        self._refused(data, capsys, "look alike")
