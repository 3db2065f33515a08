"""Data sets that people have, each in a file that the format's own library has made."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from tests.shared.small_clips import RATE, SIDE, cells, pictures, swing  # noqa: F401
from tests.vidphys.cli.test_train_verb import coarse
from vidphys.cli import main
from vidphys.data.dataset import clip_file, find_dataset
from vidphys.data.labels import read_labels
from vidphys.data.rendered import write_video
from vidphys.data.sets import SETS, only_clip, set_of
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

FRAMES, CLIPS = 12, 3
WHOLE = ClipSelection()
TIMES = np.arange(FRAMES) / RATE


def places(clip: int) -> np.ndarray:
    return swing(FRAMES, float(clip))


def film(clip: int) -> np.ndarray:
    return pictures(places(clip))


def film_bytes(folder: Path, clip: int) -> bytes:
    path = folder / "one.avi"
    write_video(path, film(clip), RATE)
    data = path.read_bytes()
    path.unlink()
    return data


def png(frame: np.ndarray) -> bytes:
    return cv2.imencode(".png", frame[..., ::-1])[1].tobytes()


def check(path: Path, lossless: bool = True, splits: bool = False, count: int = CLIPS) -> list:
    """Frames, times and labels of every clip are what was written."""
    found = find_dataset(path)
    assert len(found.files) == count
    for k, file in enumerate(found.files):
        video = open_video(file.path, WHOLE)
        wanted = film(k % CLIPS)
        assert video.frames.shape == wanted.shape
        off = np.abs(np.asarray(video.frames).astype(int) - wanted)
        assert off.max() == 0 if lossless else off.mean() < 6
        np.testing.assert_allclose(video.times - video.times[0], TIMES, atol=1e-3)
        assert video.notes == ()  # a set declares nothing that its times could contradict
        assert video.decoder.split()[0] in ("opencv-python-headless", "numpy", "h5py")
        assert file.labels is not None
        got = read_labels(file.labels, video, WHOLE, 1.0).positions[0].double()
        expected = (places(k % CLIPS) + 0.5 - SIDE / 2) / (SIDE / 2) * [1, -1]
        torch.testing.assert_close(got, torch.from_numpy(expected), atol=1e-5, rtol=0)
        assert clip_file(file.path).path == file.path
    assert len({open_video(f.path, WHOLE).sha256 for f in found.files}) == min(count, CLIPS)
    if splits:
        assert [f.split for f in found.files][:2] == ["train", "train"]
        assert found.files[2].split in ("val", "test")
    return list(found.files)


def test_hugging_face_rows_that_are_clips(tmp_path: Path) -> None:
    from datasets import Dataset, DatasetDict, Features, List, Value, Video

    features = Features(
        {"video": Video(), "u": List(Value("float64")), "v": List(Value("float64"))}
        | {"operator": Value("string"), "charge": Value("float32")}
    )

    def rows(clips: list[int]) -> Dataset:
        held = {
            "video": [{"bytes": film_bytes(tmp_path, k), "path": "a.avi"} for k in clips],
            "u": [places(k)[:, 0, 0].tolist() for k in clips],
            "v": [places(k)[:, 0, 1].tolist() for k in clips],
            "operator": ["Ada", "Bo", "Cy"][: len(clips)],
            "charge": [0.5] * len(clips),
        }
        return Dataset.from_dict(held, features)

    made = DatasetDict({"train": rows([0, 1]), "test": rows([2])})
    made.save_to_disk(tmp_path / "set")
    files = check(tmp_path / "set", splits=True)
    assert files[1].facts == {"operator": "Bo", "charge": 0.5}
    assert files[1].path == tmp_path / "set" / "train" / "1"


def test_hugging_face_rows_that_are_frames(tmp_path: Path) -> None:
    from datasets import Dataset, Features, Image, Value

    features = Features(
        {"image": Image(), "episode_index": Value("int64"), "timestamp": Value("float64")}
        | {"u1": Value("float64"), "v1": Value("float64"), "room": Value("string")}
    )
    rows = [
        {"image": {"bytes": png(film(k)[t]), "path": None}, "episode_index": k, "room": "red"}
        | {"timestamp": TIMES[t], "u1": places(k)[t, 0, 0], "v1": places(k)[t, 0, 1]}
        for k in range(CLIPS)
        for t in range(FRAMES)
    ]
    Dataset.from_list(rows, features).save_to_disk(tmp_path / "set", num_shards=2)
    files = check(tmp_path / "set")
    assert files[2].facts["room"] == "red" and files[2].facts["episode_index"] == 2


def test_hugging_face_lists_of_images(tmp_path: Path) -> None:
    from datasets import Dataset, Features, Image, List, Value

    features = Features(
        {"frames": List(Image()), "fps": Value("float64")}
        | {"pixels": List(List(List(Value("float64"))))}
    )
    rows = [
        {"frames": [{"bytes": png(x), "path": None} for x in film(k)], "fps": RATE}
        | {"pixels": places(k).tolist()}
        for k in range(CLIPS)
    ]
    Dataset.from_list(rows, features).save_to_disk(tmp_path / "set")
    check(tmp_path / "set")


def test_a_file_that_a_row_names_must_lie_in_the_set(tmp_path: Path) -> None:
    from datasets import Dataset, Features, Video

    outside = tmp_path / "secret.avi"
    outside.write_bytes(film_bytes(tmp_path, 0))
    made = pa.table(
        {"video": pa.array([{"bytes": None, "path": str(outside)}])},
        Features({"video": Video()}).arrow_schema,
    )
    Dataset(made).save_to_disk(tmp_path / "set")
    arrow = next((tmp_path / "set").glob("*.arrow"))
    with pa.ipc.new_stream(str(arrow), made.schema) as out:
        out.write_table(made)
    file = find_dataset(tmp_path / "set").files[0]
    with pytest.raises(InputError, match="names the file .*, which is not in its folder"):
        open_video(file.path, WHOLE)


@pytest.mark.parametrize("kind", ["films", "pictures", "frames"])
def test_webdataset(tmp_path: Path, kind: str) -> None:
    import webdataset

    (tmp_path / "set").mkdir()
    for shard, clips in (("train-000.tar", (0, 1)), ("val-000.tar", (2,))):
        with webdataset.TarWriter(str(tmp_path / "set" / shard)) as out:
            for k in clips:
                u, v = places(k)[:, 0].T.tolist()
                about = {"u1": u, "v1": v, "time": TIMES.tolist(), "mood": "calm"}
                if kind == "films":
                    films = {"avi": film_bytes(tmp_path, k)}
                    out.write({"__key__": f"{k:04d}", "json": about, "cls": 7, **films})
                elif kind == "pictures":
                    shown = {f"{t:03d}.png": png(x) for t, x in enumerate(film(k))}
                    out.write({"__key__": f"{k:04d}", "json": about, **shown})
                else:
                    for t, x in enumerate(film(k)):
                        row = {"u1": u[t], "v1": v[t], "time": TIMES[t], "mood": "calm"}
                        out.write({"__key__": f"{k:04d}/{t:03d}", "json": row, "png": png(x)})
    files = check(tmp_path / "set", splits=True)
    assert files[0].facts["mood"] == "calm"
    if kind == "films":
        assert files[0].facts["cls"] == 7
        assert find_dataset(tmp_path / "set" / "train-000.tar").files[1].path.name == "0001"


def test_hdf5(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "set.h5", "w") as out:
        for k in range(CLIPS):
            group = out.create_group(f"trial {k}")
            group.create_dataset("frames", data=film(k), compression="gzip", chunks=True)
            group["pixels"], group["times"] = places(k), TIMES
            group.attrs["split"] = "test" if k == 2 else "train"
            group.attrs["subject"] = "left-handed"
        out["elsewhere"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/")
    files = check(tmp_path / "set.h5", splits=True)
    assert files[0].facts == {"subject": "left-handed"}
    assert open_video(tmp_path / "set.h5" / "trial 1", WHOLE).decoder.startswith("h5py ")


def test_hdf5_that_lies_in_another_file_is_refused(tmp_path: Path) -> None:
    import h5py

    (tmp_path / "secret").write_bytes(bytes(3 * 4 * 4 * 3))
    with h5py.File(tmp_path / "set.h5", "w") as out:
        elsewhere = [(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
        out.create_dataset("frames", (3, 4, 4, 3), np.uint8, external=elsewhere)
    with pytest.raises(InputError, match="set.h5: /frames lies in another file"):
        find_dataset(tmp_path / "set.h5")


@pytest.mark.parametrize("order", ["thwc", "tchw"])
def test_npz(tmp_path: Path, order: str) -> None:
    frames = film(0) if order == "thwc" else film(0).transpose(0, 3, 1, 2)
    points = ((places(0) + 0.5) / SIDE).transpose(1, 0, 2)
    hidden = np.zeros((1, FRAMES), bool)
    held = {"points": points, "occluded": hidden, "times": TIMES, "task": np.array("swing")}
    np.savez_compressed(tmp_path / "clip.npz", video=frames, **held)
    (file,) = check(tmp_path / "clip.npz", count=1)
    assert file.facts == {"task": "swing"}
    np.savez(tmp_path / "wrong.npz", frames=film(0) / 255.0)
    with pytest.raises(InputError, match="'frames' holds float64; frames are uint8"):
        find_dataset(tmp_path / "wrong.npz")


def write_lerobot(root: Path, image: bool = False) -> None:
    """By the rules of LeRobotDataset v3.0: its package would bring another version of torch."""
    key = "observation.images.top"
    default = {
        **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64"),
        "timestamp": "float32",
    }
    features = {k: {"dtype": d, "shape": [1], "names": None} for k, d in default.items()}
    features["observation.state"] = {"dtype": "float64", "shape": [2], "names": ["u", "v"]}
    names = ["height", "width", "channels"]
    dtype = "image" if image else "video"
    features[key] = {"dtype": dtype, "shape": [SIDE, SIDE, 3], "names": names}
    info = {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": CLIPS,
        "total_frames": CLIPS * FRAMES,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": int(RATE),
        "splits": {"train": "0:2", "test": "2:3"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": features,
    }
    (root / "meta/episodes/chunk-000").mkdir(parents=True)
    (root / "data/chunk-000").mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps(info))
    rows, episodes = [], []
    for k in range(CLIPS):
        for t in range(FRAMES):
            row = {"timestamp": np.float32(TIMES[t]), "frame_index": t, "episode_index": k}
            row |= {"index": k * FRAMES + t, "task_index": 0}
            row["observation.state"] = places(k)[t, 0].tolist()
            rows.append(row | ({key: {"bytes": png(film(k)[t]), "path": None}} if image else {}))
        one = {"episode_index": k, "tasks": ["swing"], "length": FRAMES}
        one |= {"data/chunk_index": 0, "data/file_index": 0}
        one |= {"dataset_from_index": k * FRAMES, "dataset_to_index": (k + 1) * FRAMES}
        begin = {"from_timestamp": k * FRAMES / RATE, "to_timestamp": (k + 1) * FRAMES / RATE}
        where = {"chunk_index": 0, "file_index": 0, **begin}
        episodes.append(one | {f"videos/{key}/{name}": x for name, x in where.items()})
    pq.write_table(pa.Table.from_pylist(rows), root / "data/chunk-000/file-000.parquet")
    pq.write_table(
        pa.Table.from_pylist(episodes), root / "meta/episodes/chunk-000/file-000.parquet"
    )
    if not image:
        path = root / f"videos/{key}/chunk-000/file-000.mp4"
        path.parent.mkdir(parents=True)
        fourcc = cv2.VideoWriter.fourcc(*"mp4v")
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, RATE, (SIDE, SIDE))
        for frame in np.concatenate([film(k) for k in range(CLIPS)]):
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
        writer.release()


@pytest.mark.parametrize("image", [False, True])
def test_lerobot(tmp_path: Path, image: bool) -> None:
    write_lerobot(tmp_path / "set", image)
    files = check(tmp_path / "set", lossless=image, splits=True)
    assert files[1].facts["task"] == "swing" and files[1].facts["episode_index"] == 1


def test_a_lerobot_set_is_read_from_where_one_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_lerobot(tmp_path / "set")
    monkeypatch.chdir(tmp_path)
    check(Path("set"), lossless=False, splits=True)


@pytest.mark.parametrize(
    "path",
    [
        "../{file_index}.parquet",
        "data/{file_index:0999999999d}",
        "{file_index.__class__}",
        "/etc/passwd",
    ],
)
def test_a_lerobot_set_leads_nowhere_else(tmp_path: Path, path: str) -> None:
    write_lerobot(tmp_path / "set")
    (tmp_path / "0.parquet").write_bytes(b"")
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    (tmp_path / "set/meta/info.json").write_text(json.dumps({**info, "data_path": path}))
    with pytest.raises(InputError, match="is not in this data set|has other blanks"):
        find_dataset(tmp_path / "set")


def test_an_older_lerobot_set_says_what_to_do(tmp_path: Path) -> None:
    write_lerobot(tmp_path / "set")
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    text = json.dumps({**info, "codebase_version": "v2.1"})
    (tmp_path / "set/meta/info.json").write_text(text)
    with pytest.raises(InputError, match="LeRobotDataset v2.1; version 3 is read: convert it"):
        find_dataset(tmp_path / "set")


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "tapvid_davis.pkl").write_bytes(b"cos\nsystem\n(S'touch /tmp/no'\ntR.")
    with pytest.raises(InputError, match="a pickle can run any code, so it is not opened; load it"):
        find_dataset(tmp_path / "tapvid_davis.pkl")


def test_a_set_is_known_by_what_is_in_it(tmp_path: Path) -> None:
    assert list(SETS) == ["lerobot", "huggingface", "webdataset", "arrays", "pictures"]
    np.savez(tmp_path / "tracks.npz", positions=np.zeros((3, 1, 2)))
    assert set_of(tmp_path / "tracks.npz") is None and set_of(tmp_path) is None
    with pytest.raises(InputError, match="no such clip; .*set.h5 has a, b"):
        import h5py

        with h5py.File(tmp_path / "set.h5", "w") as out:
            out["a/frames"] = out["b/frames"] = film(0)
        open_video(tmp_path / "set.h5" / "c", WHOLE)
    with pytest.raises(InputError, match="without times; give the frames per second as `rate`"):
        open_video(tmp_path / "set.h5" / "a", WHOLE)
    assert len(open_video(tmp_path / "set.h5" / "a", ClipSelection(rate=25)).times) == FRAMES


@pytest.mark.usefixtures("cells")
class TestVerbs:
    @pytest.fixture
    def made(self, tmp_path: Path) -> Path:
        import h5py

        with h5py.File(tmp_path / "runs.h5", "w") as out:
            for k in range(CLIPS):
                group = out.create_group(f"trial {k}")
                long = swing(24, float(k))
                group["frames"], group["pixels"] = pictures(long), long
                group.attrs["fps"] = RATE
        return tmp_path / "runs.h5"

    def test_extract_takes_all_of_a_set_and_one_of_it(
        self, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        how = ["--encoder", "cells", "--out", str(tmp_path / "store"), "--quiet"]
        assert main(["extract", str(made / "trial 1"), *how]) == 0
        assert f"{made / 'trial 1'}: extracted, 24 frames" in capsys.readouterr().out
        assert main(["extract", str(made), *how]) == 0
        said = capsys.readouterr().out
        assert "3 clips, 72 frames" in said and "trial 1: in store" in said

    def test_train_takes_a_set_and_rollout_a_clip_of_it(
        self, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        coarse(monkeypatch)
        run, kept = tmp_path / "run", ["--store", str(tmp_path / "store"), "--quiet"]
        quick = ["--encoder", "cells", "--readout", "attention", "--steps", "8"]
        quick += ["--head-steps", "2", "--beyond", "0.2"]
        assert main(["train", str(made), *quick, *kept, "--out", str(run)]) == 0
        about = json.loads((run / "run.json").read_text())
        assert about["labels"] == "labels: arrays beside the frames (1 body)"
        assert [clip["clip"] for clip in about["clips"]] == ["trial 0", "trial 1", "trial 2"]
        assert about["settings"]["sha256"].keys() == {"runs.h5"}
        rolled = ["--out", str(tmp_path / "rolled"), "--beyond", "0.2", "--quiet"]
        assert main(["rollout", str(run), str(made / "trial 2"), *rolled]) == 0

    def test_diagnose_takes_a_clip_of_it(
        self, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        look = ["--look", "--out", str(tmp_path / "look"), "--quiet"]
        assert main(["diagnose", str(made / "trial 0"), *look]) == 0
        assert "1: " in capsys.readouterr().out
        assert main(["diagnose", str(made / "trial 9"), *look]) == 2
        assert "no such clip" in capsys.readouterr().err


@pytest.mark.slow
def test_folders_of_numbered_pictures_are_clips(tmp_path, capsys) -> None:
    for clip in range(CLIPS):
        folder = tmp_path / "set" / f"clip {clip}"
        folder.mkdir(parents=True)
        for k, frame in enumerate(film(clip)):
            (folder / f"img_{k}.png").write_bytes(png(frame))  # 2 comes before 10
    found = find_dataset(tmp_path / "set")
    for k, file in enumerate(found.files):
        with pytest.raises(InputError, match="frames without times; give the frames per second"):
            open_video(file.path, WHOLE)
        video = open_video(file.path, ClipSelection(rate=RATE))
        assert np.array_equal(np.asarray(video.frames), film(k))
        np.testing.assert_allclose(video.times, TIMES)
    one = tmp_path / "set" / "clip 1"
    (alone,) = find_dataset(one).files
    assert np.array_equal(
        np.asarray(open_video(alone.path, ClipSelection(rate=RATE)).frames), film(1)
    )
    assert only_clip(one) == alone.path
    with pytest.raises(InputError, match="3 clips; give one of them: .*clip 0.0, .*clip 1.0"):
        only_clip(tmp_path / "set")
    assert main(["diagnose", str(one), "--rate", "25", "--out", str(tmp_path / "run")]) in (0, 1)
    assert "no such file" not in capsys.readouterr().err


@pytest.mark.parametrize("other", ["notes.txt", "clip.mp4", "cover.png"])
def test_a_folder_with_something_else_in_it_is_no_clip(tmp_path, other) -> None:
    for k, frame in enumerate(film(0)):
        (tmp_path / f"{k}.png").write_bytes(png(frame))
    assert set_of(tmp_path) is SETS["pictures"]
    (tmp_path / other).write_bytes(b"?")
    assert set_of(tmp_path) is None
    assert only_clip(tmp_path) == tmp_path
