"""What is written is what other people's libraries read: Parquet, LeRobotDataset, WebDataset."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore
from vidphys.cli import main
from vidphys.data import exports
from vidphys.diagnose.recordings.tables import read_tracks
from vidphys.errors import InputError

FRAMES, AHEAD = 20, 60
TIMES = 0.5 + np.arange(FRAMES) / 25
LATER = TIMES[-1] + np.arange(AHEAD) / 100


def path(times: np.ndarray) -> np.ndarray:
    """Two bodies on straight lines, ``(t, 2, 2)``."""
    return np.stack([np.stack([times, 2 * times], -1), np.stack([-times, 1 + times], -1)], 1)


@pytest.fixture
def rolled(tmp_path: Path) -> Path:
    run = tmp_path / "rolled"
    run.mkdir()
    held = {"times": TIMES, "track": path(TIMES), "confidence": np.full((FRAMES, 2), 0.5)}
    later = {"rollout_times": LATER, "rollout": path(LATER), "changed": -path(LATER)}
    np.savez(run / "rollout.npz", **held, **later)
    return run


def values(clip: int) -> np.ndarray:
    return np.random.default_rng(clip).random((FRAMES, 4, 2, 3)).astype(np.float32)


@pytest.fixture
def store(tmp_path: Path) -> Path:
    who = EncoderIdentity("mine", 1, "0" * 64, "none", "last", 32, "float32")
    kept = FeatureStore(tmp_path / "store")
    for clip in range(2):
        times = tuple(TIMES.tolist())
        request = FeatureRequest(
            who, f"{clip}" * 64, tuple(range(FRAMES)), times, (32, 48), "float32"
        )
        made = FeatureMap(torch.from_numpy(values(clip))[None], (16.0, 16.0), torch.tensor(times))
        kept.get(request, f"clips/{clip}.mp4", lambda made=made: made)
    return tmp_path / "store"


def export(source: Path, form: str) -> Path:
    out = source.parent / form
    assert main(["export", str(source), "--to", form, "--out", str(out)]) == 0
    return out


def test_rollouts_as_parquet(rolled: Path) -> None:
    out = export(rolled, "parquet")
    track = pq.read_table(out / "frames.parquet").to_pandas()
    assert list(track["episode"].unique()) == ["track"] and len(track) == FRAMES
    np.testing.assert_array_equal(track[["x1", "y1"]].to_numpy(), path(TIMES)[:, 0])
    assert (track["confidence2"] == 0.5).all()
    later = pq.read_table(out / "frames-2.parquet").to_pandas()
    assert list(later["episode"].unique()) == ["rollout", "changed"]
    changed = later[later["episode"] == "changed"]
    np.testing.assert_array_equal(changed[["x2", "y2"]].to_numpy(), -path(LATER)[:, 1])
    np.testing.assert_allclose(changed["time"], LATER)
    motion = read_tracks(out / "frames.parquet").motion
    np.testing.assert_allclose(motion.positions[0], path(TIMES))


def test_features_as_parquet(store: Path) -> None:
    table = pq.read_table(export(store, "parquet") / "frames.parquet")
    field = table.schema.field("observation.features")
    shape = json.loads(field.metadata[b"shape"])
    flat = np.array(table["observation.features"].to_pylist(), np.float32)
    both = flat.reshape(2, FRAMES, *shape)
    clips = table["clip"].to_pylist()[::FRAMES]
    for k, clip in enumerate(clips):
        np.testing.assert_array_equal(both[k], values(int(Path(clip).stem)))
    assert set(table["layer"].to_pylist()) == {"last"}


def test_rollouts_as_lerobot(rolled: Path) -> None:
    import datasets
    import pandas as pd

    out = export(rolled, "lerobot")
    info = json.loads((out / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == 25
    assert info["total_episodes"] == 3 and info["splits"] == {"train": "0:3"}
    state = info["features"]["observation.state"]
    assert state == {"dtype": "float32", "shape": [4], "names": ["x1", "y1", "x2", "y2"]}
    files = sorted(map(str, out.glob("data/*/*.parquet")))
    rows = datasets.Dataset.from_parquet(files, cache_dir=str(out.parent / "cache"))
    assert rows.num_rows == info["total_frames"]
    assert set(rows.column_names) == set(info["features"])
    rows.set_format("numpy")
    np.testing.assert_allclose(rows["index"][:], np.arange(rows.num_rows))
    episodes = pd.read_parquet(out / "meta/episodes/chunk-000/file-000.parquet")
    for k, row in episodes.iterrows():
        own = rows[row["dataset_from_index"] : row["dataset_to_index"]]
        assert set(own["episode_index"]) == {k} and len(own["index"]) == row["length"]
        np.testing.assert_allclose(own["timestamp"], np.arange(row["length"]) / 25, rtol=1e-6)
        at = (TIMES[0] if k == 0 else LATER[0]) + np.arange(row["length"]) / 25
        wanted = (-1 if k == 2 else 1) * path(at).reshape(len(at), 4)
        np.testing.assert_allclose(own["observation.state"], wanted, rtol=1e-5, atol=1e-6)
    tasks = pd.read_parquet(out / "meta/tasks.parquet")
    assert tasks.loc["roll on under the law that held"].task_index == 1
    stats = json.loads((out / "meta/stats.json").read_text())
    every = np.asarray(rows["observation.state"][:])
    np.testing.assert_allclose(stats["observation.state"]["mean"], every.mean(0), rtol=1e-5)
    np.testing.assert_allclose(stats["observation.state"]["std"], every.std(0), rtol=1e-4)
    assert stats["timestamp"]["count"] == [rows.num_rows]


def test_features_as_lerobot(store: Path) -> None:
    out = export(store, "lerobot")
    info = json.loads((out / "meta/info.json").read_text())
    assert info["features"]["observation.features"]["shape"] == [4, 2, 3]
    table = pq.read_table(next(out.glob("data/*/*.parquet")))
    held = np.array(table["observation.features"].to_pylist(), np.float32)
    found = {held[:FRAMES].tobytes(), held[FRAMES:].tobytes()}
    assert found == {values(0).tobytes(), values(1).tobytes()}


@pytest.mark.parametrize("kind", ["rolled", "store"])
def test_webdataset(kind: str, request: pytest.FixtureRequest) -> None:
    import webdataset

    source: Path = request.getfixturevalue(kind)
    shards = sorted(map(str, export(source, "webdataset").glob("*.tar")))
    samples = list(webdataset.WebDataset(shards, shardshuffle=False).decode())
    if kind == "rolled":
        assert [s["__key__"] for s in samples] == ["track", "rollout", "changed"]
        held = samples[2]["json"]
        np.testing.assert_array_equal(np.stack([held["x1"], held["y1"]], -1), -path(LATER)[:, 0])
        assert held["time"] == LATER.tolist()
        return
    for sample in samples:
        clip = int(Path(sample["json"]["clip"]).stem)
        np.testing.assert_array_equal(sample["features.npy"], values(clip))
        assert sample["json"]["stride"] == [16.0, 16.0]


def test_what_cannot_be_written_is_said_and_leaves_nothing(
    rolled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(source: Path, out: str, words: str, form: str = "lerobot") -> None:
        assert main(["export", str(source), "--to", form, "--out", str(tmp_path / out)]) == 2
        assert words in capsys.readouterr().err

    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "a", "neither a finished `vidphys rollout` nor a feature store")
    refused(rolled, "rolled", "something lies there; choose another folder")
    held = dict(np.load(rolled / "rollout.npz"))
    held["times"] = np.sort(np.random.default_rng(0).random(FRAMES))
    np.savez(rolled / "rollout.npz", **held)
    refused(rolled, "b", "track: its frames come unevenly, and LeRobot knows one rate")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty", "rolled"]


def test_f7_two_that_export_to_one_folder_do_not_touch_what_the_other_writes(
    rolled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, write, left = tmp_path / "out", exports.EXPORTS["parquet"], []
    (tmp_path / ".out.4711.partial").mkdir()
    (tmp_path / ".out.4711.partial" / "killed").touch()

    def slow(folder, episodes):
        count = write(folder, episodes)
        monkeypatch.setitem(exports.EXPORTS, "parquet", write)
        before = {p: p.read_bytes() for p in folder.iterdir()}
        left.append(exports.export(rolled, out, "parquet"))
        left.append({p: p.read_bytes() for p in folder.iterdir()} == before != {})
        return count

    monkeypatch.setitem(exports.EXPORTS, "parquet", slow)
    with pytest.raises(InputError, match="cannot be written"):  # the other was first
        exports.export(rolled, out, "parquet")
    assert left == [3, True] and len(pq.read_table(out / "frames.parquet"))
    assert not [*tmp_path.glob(".out*")]
