"""`vidphys render`: a folder of clips that is whole, exact, repeatable and goes on."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from renderers import Camera, RgbWorld
from vidphys.cli import main
from vidphys.data import rendered
from vidphys.data.dataset import clip_file, find_dataset
from vidphys.data.labels import read_labels
from vidphys.data.rendered import write_video
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError
from vidphys.runs.records import read_table

TINY = ["--frames", "4", "--image", "16", "--quiet"]
WHOLE = ClipSelection()


@pytest.fixture(autouse=True)
def few_at_once(monkeypatch):
    monkeypatch.setattr(rendered, "AT_ONCE", 2)


def render(out, *more) -> int:
    return main(["render", "--out", str(out), *TINY, *more])


def _hashes(out) -> list[str]:
    return [entry["sha256"] for entry in json.loads((out / "dataset.json").read_text())["clips"]]


def test_videos_keep_every_pixel(tmp_path):
    frames = np.random.default_rng(0).integers(0, 256, (5, 18, 32, 3), dtype=np.uint8)
    write_video(tmp_path / "v.avi", frames, 12.5)
    back = open_video(tmp_path / "v.avi", WHOLE)
    assert np.array_equal(back.frames, frames)
    np.testing.assert_allclose(back.times, np.arange(5) * 0.08, atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == ["v.avi"]


def test_the_labels_are_where_the_bodies_are_drawn(tmp_path):
    assert render(tmp_path / "d", "--clips", "3") == 0
    found = find_dataset(tmp_path / "d")
    assert len(found.files) == 3 and found.half_extent == 4.0 and found.conserving
    for file in found.files:
        video = open_video(file.path, WHOLE)
        assert video.notes == ()
        labels = read_labels(file.labels, video, WHOLE, found.half_extent)
        world = RgbWorld(camera=Camera(height=16, width=16))
        drawn = (world(4.0 * labels.positions[0]) * 255).round().permute(0, 2, 3, 1)
        assert float((drawn - torch.from_numpy(np.asarray(video.frames))).abs().max()) <= 1
        assert 0.5 <= file.coupling <= 1.5 and file.mass == (1.0, 1.0, 1.0)
        again = clip_file(file.path)
        assert (again.labels.path, again.truth.path) == (file.labels.path, file.truth.path)
        assert replace(again, labels=file.labels, truth=file.truth) == file
    assert len({f.coupling for f in found.files}) == 3


def test_clips_do_not_depend_on_how_many_there_are_but_on_the_seed(tmp_path):
    for name, more in (("a", ["--clips", "3"]), ("b", ["--clips", "1"]), ("c", ["--clips", "1"])):
        assert render(tmp_path / name, *more, "--seed", "1" if name == "c" else "0") == 0
    assert _hashes(tmp_path / "a")[:1] == _hashes(tmp_path / "b")
    assert _hashes(tmp_path / "c") != _hashes(tmp_path / "b")


def test_an_interrupted_rendering_goes_on(tmp_path, monkeypatch):
    out = tmp_path / "d"
    real, calls = rendered.write_video, []

    def dies(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        real(*arguments)

    monkeypatch.setattr(rendered, "write_video", dies)
    assert render(out, "--clips", "3") == 130
    assert not (out / "dataset.json").exists()
    assert sorted(p.name for p in (out / "clips").iterdir()) == ["00000.avi", "00000.csv"]
    with pytest.raises(InputError, match="rendering is not finished"):
        find_dataset(out)
    assert render(out, "--clips", "3") == 0
    assert len(calls) == 4  # the first clip was not drawn again
    monkeypatch.setattr(rendered, "write_video", real)
    assert render(tmp_path / "whole", "--clips", "3") == 0
    assert _hashes(out) == _hashes(tmp_path / "whole")


@pytest.mark.parametrize("world", ["channels", "anonymous"])
def test_worlds(tmp_path, world):
    out = tmp_path / "d"
    assert render(out, "--clips", "1", "--world", world, "--scene", "springs") == 0
    frames = np.asarray(open_video(find_dataset(out).files[0].path, WHOLE).frames)
    same = bool((frames[..., 0] == frames[..., 1]).all())
    assert same == (world == "anonymous") == find_dataset(out).identical


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--clips", "0"], "--clips 0: must be at least 1"),
        (["--image", "17"], "--image 17: must be even; use 18"),
    ],
)
def test_sizes_that_make_no_sense(tmp_path, capsys, more, words):
    assert render(tmp_path / "d", *more) == 2
    assert words in capsys.readouterr().err and not (tmp_path / "d").exists()


def test_another_rendering_is_refused_and_overwritten_when_asked(tmp_path, capsys):
    out = tmp_path / "d"
    assert render(out, "--clips", "2") == 0
    assert render(out, "--clips", "1") == 2
    assert "--overwrite" in capsys.readouterr().err and len(find_dataset(out).files) == 2
    assert render(out, "--clips", "1", "--overwrite") == 0
    assert len(list((out / "clips").glob("*.avi"))) == 1


@pytest.mark.parametrize("scene", ["springs", "gravity-and-coulomb"])
def test_the_truth_beside_a_clip_obeys_the_law_that_it_tells(tmp_path, scene):
    assert render(tmp_path / "d", "--clips", "2", "--scene", scene, "--frames", "9") == 0
    manifest = json.loads((tmp_path / "d" / "dataset.json").read_text())
    table = read_table(tmp_path / "d" / manifest["clips"][1]["truth"])
    truth = {name: table[name].to_numpy() for name in table.column_names}
    labels = np.loadtxt(tmp_path / "d" / "clips" / "00001.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(truth["x1"], labels[:, 1], rtol=1e-8)
    step = truth["time"][1]
    for value, rate in (("x2", "vx2"), ("py1", "fy1")):
        rise = (truth[rate][1:] + truth[rate][:-1]) / 2 * step
        missed = np.abs(np.diff(truth[value]) - rise)
        assert np.median(missed) < 0.1 * np.median(np.abs(rise))
    np.testing.assert_allclose(truth["px1"], truth["m1"] * truth["vx1"])
    assert ("electric" in truth) == (scene == "gravity-and-coulomb")
