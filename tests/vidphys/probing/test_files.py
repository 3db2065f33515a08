"""Probes of clips in the formats that people have: what is known, what stays together, when."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.shared.small_clips import RATE, SIDE, pictures, swing, write_clip
from tests.shared.uneven import write_uneven
from tests.vidphys.data.test_labels import (
    FRAMES,
    PLACES,
    as_json,
    as_npz,
    as_parquet,
    as_tapvid_json,
    as_text,
    as_tracker,
    boxes_made_by_the_library,
)
from vidphys.data.rendered import write_video
from vidphys.data.video import ClipSelection
from vidphys.errors import InputError
from vidphys.probing.files import Files
from vidphys.probing.probe import probe

WHOLE = ClipSelection()
TRUE = (PLACES + 0.5 - SIDE / 2) / (SIDE / 2) * [1, -1]  # (t, 1, 2), of the first clip
READ = [4, 7]  # of twelve frames


def folder_of(folder: Path, clips: int, write=None) -> Path:
    """Clips of the swinging body, each from its own phase; all tables are those of the first."""
    for k in range(clips):
        write_clip(folder / f"{k}.avi", FRAMES, float(k), table=False)
        if write is not None:
            write(folder / f"{k}.avi")
    return folder


def known(folder: Path, *targets: str, each: int = 2, **how):
    return Files(folder, WHOLE, each, **how).known(targets)


def values(folder: Path, target: str, **how) -> np.ndarray:
    (labels,) = known(folder, target, **how).labels
    return labels.values


def with_boxes(path: Path) -> None:
    boxes_made_by_the_library(path.with_suffix(".json"), True)


@pytest.mark.parametrize(
    "write", [as_text, as_json, as_npz, as_parquet, as_tracker, as_tapvid_json]
)
def test_places_of_every_table_that_is_trained_on_are_targets(tmp_path: Path, write) -> None:
    folder = folder_of(tmp_path, 2, write)
    np.testing.assert_allclose(values(folder, "position"), [*TRUE[READ, 0]] * 2, atol=1e-6)
    slope = np.gradient(TRUE[:, 0], np.arange(FRAMES) / RATE, axis=0)[READ]
    np.testing.assert_allclose(values(folder, "velocity"), [*slope] * 2, atol=1e-4)


def test_boxes_of_coco_are_places_and_a_body_may_be_chosen(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 2, with_boxes)
    both = values(folder, "position", each=4)
    one = values(folder, "position", each=4, columns=(("body", "1"),))
    assert both.shape == (8, 4) and np.isnan(both[1, 2:]).all()  # not seen in frame 4
    np.testing.assert_array_equal(one, both[:, 2:])


@pytest.mark.parametrize("write", [as_text, as_json, as_parquet])
def test_any_further_column_is_a_target(tmp_path: Path, write) -> None:
    folder = folder_of(tmp_path, 2, write)
    wanted = [7.0] * 4 if write is as_text else [2.0, 3.5] * 2
    found = known(folder, "class:lamp").labels[0] if write is not as_text else None
    if found is None:
        with pytest.raises(InputError, match="target column:lamp: it is the same in all examples"):
            known(folder, "column:lamp")
        return
    assert [found.classes[int(k)] for k in found.values[:, 0]] == [str(x) for x in ("2", "3.5") * 2]
    np.testing.assert_array_equal(values(folder, "column:lamp")[:, 0], wanted)


def test_columns_choose_and_a_row_of_a_body_each_is_laid_side_by_side(tmp_path: Path) -> None:
    folder_of(tmp_path, 2)
    rows = ["frame,id,left,top,heat,weather"]
    for t, (u, v) in enumerate(PLACES[:, 0]):
        rows += [f"{t},7,{u:.9g},{v:.9g},{t},{t % 4}", f"{t},3,{u / 2:.9g},{v:.9g},{-t},{t % 4}"]
    for k in range(2):
        (tmp_path / f"{k}.csv").write_text("\n".join(rows) + "\n")
    how = {"columns": (("u", "left"), ("v", "top"))}
    found = values(tmp_path, "position", **how)
    np.testing.assert_allclose(found[:, 2:], [*TRUE[READ, 0]] * 2, atol=1e-6)  # 3 comes before 7
    assert values(tmp_path, "column:heat2", **how)[:2, 0].tolist() == READ
    assert values(tmp_path, "column:weather", **how)[:2, 0].tolist() == [0, 3]
    with pytest.raises(InputError, match="left=nowhere|no such column"):
        known(tmp_path, "position", columns=(("u", "nowhere"), ("v", "top")))


def test_a_table_without_places_has_its_columns(tmp_path: Path) -> None:
    folder_of(tmp_path, 2)
    for k in range(2):
        rows = "\n".join(f"{t};{t * k},5;{'ab'[t % 2]}" for t in range(FRAMES))
        (tmp_path / f"{k}.csv").write_text(f"frame;heat;label\n{rows}\n")
    assert values(tmp_path, "column:heat")[:, 0].tolist() == [0.5, 0.5, 4.5, 7.5]
    (labels,) = known(tmp_path, "class:label").labels
    assert labels.classes == ("a", "b") and labels.per == "frame"
    with pytest.raises(InputError) as error:
        known(tmp_path).require(1, tmp_path)
    said = str(error.value)
    assert said.count("no coordinates among the columns") == 1
    assert said.startswith(f"{tmp_path}: nothing can be learned: position, velocity, speed")
    assert said.endswith("name columns in `targets`, as column:NAME: frame, heat, label")


def data_set(path: Path, clips: int = 6) -> Path:
    with h5py.File(path, "w") as file:
        for k in range(clips):
            group = file.create_group(f"trial{k}")
            group["frames"] = pictures(swing(FRAMES, float(k)))
            group["fps"] = RATE
            group["pixels"] = swing(FRAMES, float(k))
            group["heat"] = np.arange(FRAMES) * k
            group["charge"] = 0.5 * k
            group["operator"] = ["Ada", "Bo"][k % 2]
    return path


def test_a_data_set_has_targets_by_frame_and_by_clip(tmp_path: Path) -> None:
    path = data_set(tmp_path / "runs.h5")
    place, heat, charge, who = known(
        path, "position", "column:heat", "column:charge", "class:operator"
    ).labels
    true = [swing(FRAMES, float(k))[t, 0] for k in range(6) for t in READ]
    np.testing.assert_allclose(
        place.values, (np.array(true) + 0.5 - SIDE / 2) / (SIDE / 2) * [1, -1], atol=1e-6
    )
    assert heat.values[:4, 0].tolist() == [0, 0, 4, 7] and heat.per == "frame"
    assert charge.values[::2, 0].tolist() == [0, 0.5, 1, 1.5, 2, 2.5] and charge.per == "clip"
    assert who.classes == ("Ada", "Bo") and who.per == "clip"
    with pytest.raises(InputError, match="its values are words, such as Ada; ask class:operator"):
        known(path, "column:operator")


def test_rows_of_hugging_face_without_places_are_targets(tmp_path: Path) -> None:
    from datasets import Dataset, Features, List, Value, Video

    film = tmp_path / "one.avi"
    held: dict[str, list] = {"video": [], "grip": [], "task": []}
    for k in range(4):
        write_video(film, pictures(swing(FRAMES, float(k))), RATE)
        held["video"].append({"bytes": film.read_bytes(), "path": "a.avi"})
        held["grip"].append([float(k + t) for t in range(FRAMES)])
        held["task"].append(["lift", "drop"][k % 2])
    kinds = {"video": Video(), "grip": List(Value("float64")), "task": Value("string")}
    Dataset.from_dict(held, Features(kinds)).save_to_disk(tmp_path / "set")
    assert values(tmp_path / "set", "column:grip")[:3, 0].tolist() == [4, 7, 5]
    assert values(tmp_path / "set", "class:task")[::2, 0].tolist() == [1, 0, 1, 0]


def test_groups_stay_together_and_a_clip_in_two_folds_is_an_error(tmp_path: Path) -> None:
    path = data_set(tmp_path / "runs.h5")
    assert known(path, "position").groups.tolist() == [0, 1, 2, 3, 4, 5]
    by = known(path, "position", split_by="operator")
    assert by.groups.tolist() == [0, 1] * 3
    with pytest.raises(InputError, match="2 groups of 6 clips; `folds` 5 needs at least 10"):
        by.require(5)
    with pytest.raises(InputError, match="no fact 'room' to split by; it has .*operator"):
        known(path, "position", split_by="room")
    with pytest.raises(InputError, match="`split_by` time: clips are tested whole"):
        known(path, "position", split_by="time")
    folder = folder_of(tmp_path / "clips", 2, as_text)
    for suffix in (".avi", ".csv"):
        shutil.copy(folder / f"0{suffix}", folder / f"copy{suffix}")
    with pytest.raises(
        InputError, match=r"0.avi and .*copy.avi are the same clip, and would be in"
    ):
        known(folder, "position")
    files = ("0.avi", "1.avi", "copy.avi")
    listed = [{"file": name, "facts": {"take": int(name[0] in "0c")}} for name in files]
    (folder / "dataset.json").write_text(json.dumps({"clips": listed}))
    assert known(folder, "position", split_by="take").groups.tolist() == [0, 1, 0]


def test_frames_in_memory_have_groups_too() -> None:
    """What only names the group is of no use on a group that was not seen."""
    import torch

    rng = np.random.default_rng(0)
    group = np.arange(40) // 2
    frames = torch.from_numpy(rng.random((40, 2, 3, 8, 8))).float() * 0.1
    frames[np.arange(40), :, 0, group // 8, group % 8] += 1
    label = rng.normal(size=20)[group]

    def score(split_by) -> float:
        found = probe(lambda x: x[:, :, :1], frames, {"it": label}, split_by=split_by, each=1)
        return found.best("it").score.value

    assert score("auto") > 0.5 and score(group.tolist()) < 0.1


def test_uneven_clips_keep_their_own_times_and_are_taken_nearest_to_even_ones(
    tmp_path: Path,
) -> None:
    for k in range(2):
        times = np.cumsum(np.tile([20 + 10 * k, 60 - 10 * k], FRAMES)) / 1000
        write_uneven(tmp_path / f"{k}.mkv", pictures(swing(2 * FRAMES, float(k))), times)
        rows = "\n".join(
            f"{t},{u},{v}" for t, (u, v) in enumerate(swing(2 * FRAMES, float(k))[:, 0])
        )
        (tmp_path / f"{k}.csv").write_text(f"frame,u1,v1\n{rows}\n")
    files = Files(tmp_path, WHOLE, 2)
    blocks = list(files.blocks())
    assert [len(block.frames) for block in blocks] == [1, 1]
    steps = [np.diff(block.times.numpy())[:2].round(3).tolist() for block in blocks]
    assert steps == [[0.06, 0.02], [0.05, 0.03]]
    notes = files.known(["position"]).told_notes()
    assert any(note.startswith("0.mkv: note: frames come unevenly, up to 0.") for note in notes)
    assert all("each is seen at the time that it has" in n for n in notes if "unevenly" in n)
    with pytest.raises(InputError, match="frames come up to .*give `resample`"):
        list(Files(tmp_path, ClipSelection(stride=3), 2).blocks())
    coarse = Files(tmp_path, WHOLE, 2, resample=12.5)
    assert {block.frames.shape[1] for block in coarse.blocks()} == {FRAMES}
    read = swing(2 * FRAMES, 0.0)[::2, 0][[4, 7]]
    (labels,) = coarse.known(["position"]).labels
    true = (read + 0.5 - SIDE / 2) / (SIDE / 2) * [1, -1]
    np.testing.assert_allclose(labels.values[:2], true, atol=1e-6)


def test_what_the_encoder_is_shown_is_part_of_what_features_are_filed_under(
    tmp_path: Path,
) -> None:
    folder = folder_of(tmp_path, 2, as_text)
    prints = {
        Files(folder, ClipSelection(start=start, stop=start + 8), 2).fingerprints
        for start in (0, 0, 3)
    }
    assert len(prints) == 2


def test_a_folder_of_which_nothing_is_known_says_what_would_be_read(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 2)
    with pytest.raises(InputError, match="nothing is known of its clips; a probe learns from"):
        known(folder)
    with pytest.raises(InputError, match="`columns`: would have no effect"):
        known(folder, columns=(("u", "left"),))
