"""The page on data sets: each of its blocks is run, in their order."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.vidphys.data.test_sets import film_bytes, png, write_lerobot
from vidphys.cli import main
from vidphys.data.dataset import find_dataset
from vidphys.data.labels import read_labels
from vidphys.data.sets import _read
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

PAGE = Path(__file__).parents[3] / "docs" / "data-sets.md"
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


def test_every_block_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    assert [language for language, _ in BLOCKS] == ["python", "sh", "python"]
    for language, body in BLOCKS:
        if language == "python":
            exec(compile(body, str(PAGE), "exec"), names)
        else:
            for line in body.splitlines():
                assert main(shlex.split(line)[1:]) == 0
    said = capsys.readouterr().out
    assert "labels: arrays beside the frames (1 body) D (8, 32, 32, 3) h5py" in said
    assert "5 clips, 40 frames" in said and "5 episodes as lerobot: exported" in said
    assert "torch.Size([1, 6, " in said


def webdataset_of(folder: Path) -> list[Path]:
    import webdataset

    path = folder / "a.tar"
    with webdataset.TarWriter(str(path)) as out:
        about = {"u1": [1.0] * 12, "v1": [2.0] * 12, "fps": 25}
        out.write({"__key__": "0", "json": about, "avi": film_bytes(folder, 0)})
    return [path]


def hdf5_of(folder: Path) -> list[Path]:
    import h5py

    with h5py.File(folder / "a.h5", "w") as out:
        out["frames"], out["fps"] = np.zeros((12, 8, 8, 3), np.uint8), 25
        out["pixels"] = np.ones((12, 1, 2))
    return [folder / "a.h5"]


def npz_of(folder: Path) -> list[Path]:
    np.savez(folder / "a.npz", frames=np.zeros((12, 8, 8, 3), np.uint8), fps=25)
    return [folder / "a.npz"]


def arrow_of(folder: Path) -> list[Path]:
    from datasets import Dataset, Features, Image, Value

    features = Features({"image": Image(), "timestamp": Value("float64"), "x1": Value("float64")})
    picture = {"bytes": png(np.zeros((8, 8, 3), np.uint8)), "path": None}
    rows = [{"image": picture, "timestamp": t / 25, "x1": 0.0} for t in range(12)]
    Dataset.from_list(rows, features).save_to_disk(folder / "a")
    return [next((folder / "a").glob("*.arrow")), folder / "a" / "state.json"]


def lerobot_of(folder: Path) -> list[Path]:
    write_lerobot(folder / "a", image=True)
    return [
        folder / "a/meta/info.json",
        folder / "a/meta/episodes/chunk-000/file-000.parquet",
        folder / "a/data/chunk-000/file-000.parquet",
    ]


KINDS = (webdataset_of, hdf5_of, npz_of, arrow_of, lerobot_of)


@pytest.mark.slow
@pytest.mark.parametrize("make", KINDS)
def test_hurt_sets_are_read_or_refused_in_one_line(tmp_path: Path, make) -> None:  # noqa: ANN001
    files = make(tmp_path)
    root = tmp_path / "a" if (tmp_path / "a").is_dir() else files[0]
    random, good = np.random.default_rng(0), {file: file.read_bytes() for file in files}
    refused = 0
    for turn in range(24):
        file = files[turn % len(files)]
        hurt = bytearray(good[file])
        if turn % 3 == 0:
            del hurt[int(random.integers(len(hurt))) :]
        for _ in range(4):
            if hurt:
                hurt[int(random.integers(len(hurt)))] = int(random.integers(256))
        file.unlink()  # not in place: a file that is mapped into memory must not change under it
        file.write_bytes(hurt)
        _read.cache_clear()
        try:
            for clip in find_dataset(root).files:
                video = open_video(clip.path, ClipSelection())
                if clip.labels is not None:
                    read_labels(clip.labels, video, ClipSelection(), 1.0)
        except InputError as error:
            assert "\n" not in str(error)
            refused += 1
        file.unlink()
        file.write_bytes(good[file])
    assert refused > 4
