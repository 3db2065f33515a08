"""Labels beside a clip: one reader for every table, nothing ignored without a word."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from pycocotools import mask
from pycocotools.coco import COCO
from scipy.io import savemat

from tests.shared.small_clips import pictures, swing, write_clip
from tests.vidphys.data.test_formats import project
from vidphys.data.beside import Beside
from vidphys.data.dataset import find_dataset
from vidphys.data.labels import Labels, read_labels
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

FRAMES, SIDE = 12, 32
PLACES = swing(FRAMES, 0.0)  # pixels (t, 1, 2)
WHOLE = ClipSelection()


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    write_clip(tmp_path / "clip.avi", FRAMES, table=False)
    return tmp_path / "clip.avi"


def columns() -> dict[str, np.ndarray]:
    noise = np.arange(FRAMES) * 0.5
    return {"u1": PLACES[:, 0, 0], "v1": PLACES[:, 0, 1], "lamp": noise, "operator": noise}


def as_parquet(path: Path) -> None:
    pq.write_table(pa.table(columns()), path.with_suffix(".parquet"))


def as_matlab(path: Path) -> None:
    held = {**columns(), "t": np.arange(FRAMES) / 25}
    savemat(path.with_suffix(".mat"), held)


def as_npz(path: Path) -> None:
    np.savez(path.with_suffix(".npz"), pixels=PLACES)


def as_text(path: Path) -> None:
    lines = "\n".join(f"{u:.9g};{v:.9g};7" for u, v in PLACES[:, 0]).replace(".", ",")
    path.with_suffix(".csv").write_text(f"u1;v1;lamp\n{lines}\n")


def as_json(path: Path) -> None:
    held = {name: values.tolist() for name, values in columns().items()}
    path.with_suffix(".json").write_text(json.dumps(held))


def as_rows(path: Path) -> None:
    rows = [{"frame": k, "u": u, "v": v} for k, (u, v) in enumerate(PLACES[:, 0].tolist())]
    path.with_suffix(".json").write_text(json.dumps(rows))


def as_tracker(path: Path) -> None:
    frames = range(FRAMES)
    path.with_suffix(".trk").write_text(project(frames, {"ball": PLACES[:, 0] + 0.5}, 0.3))


def as_tapvid(path: Path) -> None:
    points = ((PLACES + 0.5) / SIDE).transpose(1, 0, 2)
    np.savez(path.with_suffix(".npz"), points=points, occluded=np.zeros((1, FRAMES), bool))


def as_tapvid_json(path: Path) -> None:
    points = ((PLACES + 0.5) / SIDE).transpose(1, 0, 2)
    held = {"points": points.tolist(), "occluded": np.zeros((1, FRAMES), bool).tolist()}
    path.with_suffix(".json").write_text(json.dumps(held))


KINDS = (
    as_parquet,
    as_matlab,
    as_npz,
    as_text,
    as_json,
    as_rows,
    as_tracker,
    as_tapvid,
    as_tapvid_json,
)


@pytest.mark.parametrize("write", KINDS)
def test_every_table_beside_a_clip_is_its_labels(clip: Path, write) -> None:
    write(clip)
    found = find_dataset(clip)
    assert found.labelled
    got = read_labels(found.files[0].labels, open_video(clip, WHOLE), WHOLE, 1.0)
    wanted = (PLACES + 0.5 - SIDE / 2) / (SIDE / 2) * [1, -1]
    torch.testing.assert_close(
        got.positions[0].double(), torch.from_numpy(wanted), atol=1e-5, rtol=0
    )
    assert found.told(1).startswith("labels: clip.") and found.told(1).endswith("(1 body)")


def boxes_made_by_the_library(path: Path, tracks: bool) -> list[np.ndarray]:
    """COCO's file of boxes around masks; returns the centres of the two bodies."""
    images = [
        {"id": 100 + k, "file_name": f"frame_{k:06d}.png", "width": SIDE, "height": SIDE}
        for k in range(FRAMES)
    ]
    annotations, centres = [], [np.full((FRAMES, 2), np.nan) for _ in range(2)]
    for k in range(FRAMES):
        for body, (u, v) in enumerate(((3 + k, 5), (20, 3 + k))):
            if (k, body) == (4, 1):
                continue
            picture = np.zeros((SIDE, SIDE), np.uint8, order="F")
            picture[v : v + 5, u : u + 3] = 1
            code = mask.encode(picture)
            centres[body][k] = u + 1, v + 2
            one = {"id": 10 * k + body, "image_id": 100 + k, "bbox": mask.toBbox(code).tolist()}
            one |= {"area": float(mask.area(code)), "iscrowd": 0, "category_id": body + 1}
            annotations.append(one | ({"track_id": body, "category_id": 1} if tracks else {}))
    names = [{"id": 1, "name": "ball"}, {"id": 2, "name": "cart"}]
    order = annotations[::-1], images[::-1]
    held = {"images": order[1], "annotations": order[0], "categories": names}
    path.write_text(json.dumps(held))
    assert len(COCO(str(path)).getAnnIds()) == 2 * FRAMES - 1
    return centres


@pytest.mark.parametrize("tracks", [True, False])
def test_coco_boxes_are_bodies_by_track_or_category(clip: Path, tracks: bool) -> None:
    centres = boxes_made_by_the_library(clip.with_suffix(".json"), tracks)
    labels = Labels.of(clip.with_suffix(".json"))
    found = labels.read({}).positions[0]
    np.testing.assert_allclose(found, np.stack(centres, 1))
    one = labels.read({"body": "1" if tracks else "cart"}).positions[0]
    np.testing.assert_allclose(one[:, 0], centres[1])
    got = read_labels(labels, open_video(clip, WHOLE), WHOLE, 1.0)
    assert got.confidence[0, :, 1].tolist() == [1.0] * 4 + [0.0] + [1.0] * 7
    with pytest.raises(InputError, match="columns` body=NAME"):
        labels.read({"body": "dog"})


def test_two_boxes_of_a_category_need_tracks(clip: Path) -> None:
    boxes_made_by_the_library(clip.with_suffix(".json"), False)
    held = json.loads(clip.with_suffix(".json").read_text())
    held["annotations"][1]["category_id"] = held["annotations"][0]["category_id"]
    clip.with_suffix(".json").write_text(json.dumps(held))
    with pytest.raises(InputError, match="has two boxes of cart; give each body a track_id"):
        Labels.of(clip.with_suffix(".json")).read({})


def test_a_table_that_cannot_be_used_beside_a_clip_is_an_error(clip: Path) -> None:
    for suffix, hint in ((".feather", "save it as Parquet"), (".pkl", "a pickle can run any code")):
        other = clip.with_suffix(suffix)
        other.write_bytes(b"x")
        with pytest.raises(InputError, match=f"clip{suffix} beside it would not be used: {hint}"):
            find_dataset(clip)
        other.unlink()
    as_parquet(clip)
    clip.with_suffix(".CSV").write_text("u1,v1\n1,2\n")
    with pytest.raises(InputError, match="two files of labels, clip.CSV and clip.parquet"):
        find_dataset(clip)
    clip.with_suffix(".CSV").unlink()
    clip.with_suffix(".txt").write_text("Filmed on a Sunday.\n")
    assert find_dataset(clip).labelled


def test_a_workbook_beside_a_clip_has_its_labels(clip: Path) -> None:
    book = openpyxl.Workbook()
    for row in (["frame", "u1", "v1"], *([k, *PLACES[k, 0].tolist()] for k in range(len(PLACES)))):
        book.active.append(row)
    book.save(clip.with_suffix(".xlsx"))
    (file,) = find_dataset(clip).files
    np.testing.assert_allclose(file.labels.read({}).positions[0, :, 0], PLACES[:, 0])


def test_frames_that_have_no_row_were_not_seen(clip: Path) -> None:
    rows = [(k, *PLACES[k, 0]) for k in (0, 3, 4, 11)]
    text = "\n".join(f"{k},{u},{v}" for k, u, v in rows)
    clip.with_suffix(".csv").write_text(f"frame,u1,v1\n{text}\n")
    labels = Labels.of(clip.with_suffix(".csv"))
    got = read_labels(labels, open_video(clip, WHOLE), WHOLE, 1.0)
    assert got.confidence[0, :, 0].nonzero()[:, 0].tolist() == [0, 3, 4, 11]
    some = ClipSelection(start=3, stop=5)
    got = read_labels(labels, open_video(clip, some), some, 1.0)
    assert got.confidence.tolist() == [[[1.0], [1.0]]]
    first = ClipSelection(stop=3)
    got = read_labels(labels, open_video(clip, first), first, 1.0)
    assert got.confidence.tolist() == [[[1.0], [0.0], [0.0]]]
    clip.with_suffix(".csv").write_text(f"frame,u1,v1\n{text}\n12,1,1\n")
    with pytest.raises(InputError, match="is of frames 0 to 12, but clip.avi has frames 0 to 11"):
        read_labels(labels, open_video(clip, WHOLE), WHOLE, 1.0)


def test_columns_choose_which_are_taken(clip: Path) -> None:
    held = {"left": PLACES[:, 0, 0], "top": PLACES[:, 0, 1], "x9": PLACES[:, 0, 0]}
    pq.write_table(pa.table(held), clip.with_suffix(".parquet"))
    found = find_dataset(clip, {"u": "left", "v": "top"})
    video = open_video(clip, WHOLE)
    got = read_labels(found.files[0].labels, video, WHOLE, 1.0, found.columns)
    assert got.positions.shape == (1, FRAMES, 1, 2)
    assert pictures(PLACES).shape[0] == FRAMES


def test_a_folder_is_listed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(5):
        (tmp_path / f"{k}.mp4").write_bytes(b"")
    calls, listed = [], Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda self: calls.append(self) or listed(self))
    beside = Beside()
    assert [beside.labels(tmp_path / f"{k}.mp4") for k in range(5)] == [None] * 5
    assert len(calls) == 1
