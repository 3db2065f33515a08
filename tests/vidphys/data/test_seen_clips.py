"""Between clips and training: labels, splits, feature frames, cached features."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from binders.tracks import Tracks
from encoders.features import FeatureMap
from encoders.known_weights import KNOWN
from encoders.store import FeatureStore
from tests.shared.small_clips import Cells, CellsSettings, write_clip
from vidphys.cli import main
from vidphys.data.dataset import clip_file, find_dataset
from vidphys.data.extraction import extract, extract_layers
from vidphys.data.feature_frames import frame_targets
from vidphys.data.labels import read_labels, write_labels
from vidphys.data.splits import roles_by_group, split_clips, split_frames
from vidphys.data.video import ClipSelection, Video, open_video
from vidphys.errors import InputError
from vidphys.reading.reader import LoadedEncoder, Reader

WHOLE = ClipSelection()


def video(frames: int, height: int = 40, width: int = 80, stride: int = 1) -> Video:
    indices = np.arange(0, frames, stride)
    pictures = np.zeros((len(indices), height, width, 3), np.uint8)
    return Video(Path("v.avi"), "a" * 64, pictures, indices / 10, indices, ())


def test_pixels_and_units_are_the_same_places(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("time,u1,v1\n5,0,0\n5.1,79,39\n5.2,39.5,19.5\n")
    got = read_labels(tmp_path / "p.csv", video(3), WHOLE, 7.0).positions[0, :, 0]
    expected = torch.tensor([[-39.5, 19.5], [39.5, -19.5], [0, 0]]) / 40
    torch.testing.assert_close(got, expected)
    world = 7.0 * expected.numpy()[:, None]
    write_labels(tmp_path / "w.csv", np.arange(3) / 10, world)
    torch.testing.assert_close(
        read_labels(tmp_path / "w.csv", video(3), WHOLE, 7.0).positions[0, :, 0], expected
    )
    np.savez(tmp_path / "w.npz", positions=world, times=np.arange(3) / 10)
    torch.testing.assert_close(
        read_labels(tmp_path / "w.npz", video(3), WHOLE, 7.0).positions[0, :, 0], expected
    )


def test_bodies_that_are_not_seen_are_filled_in_and_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("x1,y1,x2,y2\n0,0,1,1\n,,1,1\n4,2,1,1\n")
    tracks = read_labels(tmp_path / "p.csv", video(3), WHOLE, 1.0)
    assert tracks.confidence[0].tolist() == [[1, 1], [0, 1], [1, 1]]
    assert tracks.positions[0, 1, 0].tolist() == [2, 1]


def test_a_table_has_all_frames_of_the_file(tmp_path: Path) -> None:
    rows = "\n".join(f"{k},{k}" for k in range(10))
    (tmp_path / "p.csv").write_text(f"x1,y1\n{rows}\n")
    some = ClipSelection(stride=4)
    seen = video(10, stride=4)
    assert read_labels(tmp_path / "p.csv", seen, some, 1.0).positions[0, :, 0, 0].tolist() == [
        0,
        4,
        8,
    ]
    with pytest.raises(InputError, match="10 rows, but v.avi has frames up to number 11"):
        read_labels(tmp_path / "p.csv", video(12), WHOLE, 1.0)
    with pytest.raises(InputError, match="10 rows, but v.avi has frames up to number 7"):
        read_labels(tmp_path / "p.csv", video(8), WHOLE, 1.0)


def test_times_that_are_not_the_clips_are_refused(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("time,x1,y1\n0,0,0\n0.1,0,0\n0.3,0,0\n")
    with pytest.raises(InputError, match=r"differ from those of v\.avi by up to 0\.1 s"):
        read_labels(tmp_path / "p.csv", video(3), WHOLE, 1.0)
    np.savez(tmp_path / "q.npz", places=np.zeros((3, 1, 2)))
    with pytest.raises(InputError, match="needs either positions or pixels"):
        read_labels(tmp_path / "q.npz", video(3), WHOLE, 1.0)


def test_a_folder_can_say_which_law_held(tmp_path: Path) -> None:
    write_clip(tmp_path / "sub" / "a.avi", 3)
    about = {"half_extent": 2.5, "clips": [{"file": "sub/a.avi", "coupling": -2, "mass": [3]}]}
    (tmp_path / "dataset.json").write_text(json.dumps(about))
    found = find_dataset(tmp_path)
    assert found.half_extent == 2.5 and found.labelled and not found.conserving
    law = clip_file(tmp_path / "sub" / "a.avi").law(1)
    assert law.coupling.tolist() == [-2] and law.mass.tolist() == [[3]]
    with pytest.raises(InputError, match="2 bodies, but its data set has 1 masses"):
        found.files[0].law(2)
    about["clips"].append({"file": "b.avi"})
    (tmp_path / "dataset.json").write_text(json.dumps(about))
    with pytest.raises(InputError, match=r"lists b\.avi, which is not there"):
        find_dataset(tmp_path)


def test_one_clip_is_cut_in_time() -> None:
    split = split_frames(100, 100, 1, 0.6)
    seen = torch.cat([split.train[0], split.held_out[0]]).sort().values
    assert seen.tolist() == list(range(60)) and split.known == split.asked == (60,)
    assert split.held_out[0].tolist() == [*range(16, 24), *range(56, 60)]
    assert split.scored[0].tolist() == list(range(60, 100))
    coarse = split_frames(98, 25, 4, 0.6)
    assert coarse.known == (60,) and coarse.scored[0].tolist() == list(range(15, 25))


@pytest.mark.parametrize(("frames", "share"), [(100, 0.2), (100, 1.0), (100, -1.0), (41, 0.99)])
def test_one_clip_needs_both_parts(frames: int, share: float) -> None:
    with pytest.raises(InputError, match="frames to train on and"):
        split_frames(frames, frames, 1, share)


def test_of_several_clips_whole_ones_are_held_out() -> None:
    split = split_clips([9] * 20, [5] * 20, 2, roles_by_group(range(20), 0.6))
    roles = [(len(a), len(b), len(c)) for a, b, c in zip(*_parts(split), strict=True)]
    assert roles.count((5, 0, 0)) == 10 and roles.count((0, 5, 0)) == 2
    assert roles[12:] == [(0, 0, 5)] * 8
    assert split.known == (9,) * 12 + (0,) * 8 and split.asked == (None,) * 12 + (5,) * 8
    assert [
        len(x) for x in split_clips([9] * 3, [9] * 3, 1, roles_by_group(range(3), 0.6)).held_out
    ] == [0, 9, 0]
    for count, share in ((2, 0.6), (4, 0.9), (4, 0.2)):
        with pytest.raises(InputError, match="clips to train on"):
            roles_by_group(range(count), share)


def _parts(split):  # noqa: ANN001, ANN202
    return split.train, split.held_out, split.scored


def test_feature_frames_and_frames_are_each_others_inverse() -> None:
    times = torch.arange(10, dtype=torch.float64)
    tracks = Tracks(torch.randn(1, 10, 2, 2), torch.rand(1, 10, 2), times)
    targets, weight = frame_targets(tracks, 4, 3)
    assert targets.shape == (4, 6, 2) and weight.shape == (4, 6)
    assert torch.equal(targets[1, 2:4], tracks.positions[0, 4])
    assert weight[3].tolist()[2:] == [0, 0, 0, 0]  # frames 10 and 11 are not there

    class Telling:
        def read(self, values: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
            return targets, weight

    reader = Reader(LoadedEncoder("none", {}, Cells(CellsSettings(), "0" * 64)), Telling(), 2, 1.0)
    back = reader.tracks(FeatureMap(torch.zeros(1, 4, 1, 1, 1), (1.0, 1.0), times[::3]), times)
    assert torch.equal(back.positions, tracks.positions)
    torch.testing.assert_close(back.confidence, tracks.confidence)


def test_extraction_is_cached(tmp_path: Path) -> None:
    write_clip(tmp_path / "c.avi", 5)
    clip, encoder = open_video(tmp_path / "c.avi", WHOLE), Cells(CellsSettings(), "0" * 64)
    store, calls = FeatureStore(tmp_path / "f"), []
    first = extract(clip, encoder, store, "float32", lambda done, total, _: calls.append(done))
    assert calls[-1] == 5 and not first.cached
    again = extract(clip, encoder, store, "float32", lambda *_: pytest.fail("encoded again"))
    assert again.cached and again.key == first.key
    frames = torch.from_numpy(np.asarray(clip.frames)).permute(0, 3, 1, 2)[None]
    expected = encoder(frames, torch.from_numpy(clip.times))
    assert torch.equal(again.features.values, expected.values)


def test_layers_that_are_not_in_the_store_come_from_one_pass(tmp_path: Path) -> None:
    write_clip(tmp_path / "c.avi", 5)
    clip, encoder = open_video(tmp_path / "c.avi", WHOLE), Cells(CellsSettings(), "0" * 64)
    store, before = FeatureStore(tmp_path / "f"), Cells.passes
    extract(clip, encoder.at(8), store, "float32")
    assert Cells.passes == before + 1
    found = extract_layers(clip, encoder, [2, "8", 4], store, "float32")
    assert Cells.passes == before + 2  # five frames are one pass
    assert {layer: each.cached for layer, each in found.items()} == {"2": 0, "8": 1, "4": 0}
    for layer, each in found.items():
        alone = extract(clip, encoder.at(layer), store, "float32")
        assert alone.cached and alone.key == each.key
        assert torch.equal(alone.features.values, each.features.values)
    assert Cells.passes == before + 2 and len([*store.entries()]) == 3
    with pytest.raises(ValueError, match="cells: no layer 3; it has 2, 4, 8"):
        extract_layers(clip, encoder, [3], store)


def test_real_pendulum(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clips, where = os.environ.get("VIDPHYS_CLIPS"), os.environ.get("VIDPHYS_WEIGHTS")
    if clips is None or not (Path(clips) / "pendulum_string.mp4").is_file():
        pytest.skip("VIDPHYS_CLIPS does not name a folder with pendulum_string.mp4")
    if where is None or not (Path(where) / KNOWN["hiera"].file).is_file():
        pytest.skip(f"VIDPHYS_WEIGHTS does not name a folder with {KNOWN['hiera'].file}")
    out = ["--store", str(tmp_path / "f"), "--out", str(tmp_path / "r"), "--quiet"]
    size = ["--side", "320", "--start", "10", "--steps", "600", "--shift", "2"]
    clip = str(Path(clips) / "pendulum_string.mp4")
    assert main(["train", clip, "--readout", "attention", *size, "--head-steps", "20", *out]) == 0
    said = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines()}
    rmse = {name: float(said[f"readout/{name}"][2]) for name in ("attention", "pooled", "constant")}
    pixels = 320 / 2
    assert rmse["attention"] < 0.02 * pixels
    assert rmse["attention"] < rmse["pooled"]
    assert rmse["attention"] < rmse["constant"] / 10
