"""Files of programs that track animals: SLEAP's and DeepLabCut's."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from vidphys.data.formats import read_recording
from vidphys.data.formats.foreign import read_apart
from vidphys.data.sets import only_clip
from vidphys.errors import InputError

FRAMES = 12


def sleap(path: Path, animals: list[str], nodes: list[str]) -> np.ndarray:
    """A file as SLEAP exports it; its places ``(frames, animals * nodes, 2)``."""
    places = np.random.default_rng(0).uniform(0, 300, (FRAMES, len(animals), len(nodes), 2))
    places[3, 0, 0] = np.nan
    with h5py.File(path, "w") as out:
        out["track_names"], out["node_names"] = animals, nodes
        out["tracks"] = places.transpose(1, 3, 2, 0)
        out["track_occupancy"] = np.ones((FRAMES, len(animals)))
    return places.reshape(FRAMES, -1, 2)


@pytest.mark.parametrize("animals", [[""], ["fly", "mate"]])
def test_nodes_of_sleap_are_bodies_by_their_names(tmp_path, animals) -> None:
    path = tmp_path / "video.analysis.h5"
    places = sleap(path, animals, ["head", "tail"])
    found = read_recording(path, interval=0.04)
    assert found.unit == "pixels" and found.times[0, 1] == 0.04
    np.testing.assert_array_equal(found.positions[0], places)
    name = f"{animals[-1]} tail".strip()
    one = read_recording(path, {"body": name}, 0.04)
    np.testing.assert_array_equal(one.positions[0], places[:, -1:])
    assert name in one.notes[0] and "head" not in one.notes[0]
    with pytest.raises(InputError, match="`columns`: the markers are "):
        read_recording(path, {"body": "wing"}, 0.04)


def test_an_hdf5_file_of_another_kind_says_what_to_give(tmp_path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as out:
        out["df_with_missing/table"] = np.zeros(5)
    with pytest.raises(InputError, match="no group in it has an array called frames"):
        only_clip(tmp_path / "other.h5")
    sleap(tmp_path / "elsewhere.h5", [""], ["head"])
    with h5py.File(tmp_path / "linked.h5", "w") as out:
        for name in ("tracks", "node_names", "track_names"):
            out[name] = h5py.ExternalLink(str(tmp_path / "elsewhere.h5"), name)
    with pytest.raises(InputError, match="no group in it has an array called frames"):
        only_clip(tmp_path / "linked.h5")
    with h5py.File(tmp_path / "short.h5", "w") as out:
        out["tracks"], out["node_names"], out["track_names"] = np.zeros((2, 9)), ["a"], ["b"]
    with pytest.raises(InputError, match="SLEAP has"):
        read_recording(tmp_path / "short.h5", interval=0.1)


def deeplabcut(animals: list[str], parts: list[str], first: str = "{}") -> tuple[str, np.ndarray]:
    """A table as DeepLabCut writes it, and its places ``(frames, animals * parts, 2)``."""
    places = np.random.default_rng(0).uniform(0, 300, (FRAMES, len(animals) * len(parts), 2))
    sure = np.ones((FRAMES, len(animals) * len(parts), 1))
    sure[3, 0] = 0.2
    each = [(animal, part) for animal in animals for part in parts for _ in range(3)]
    heads = [["scorer"] + ["DLC_resnet50"] * len(each)]
    heads += [["individuals"] + [a for a, _ in each]] * (len(animals) > 1)
    heads += [
        ["bodyparts"] + [p for _, p in each],
        ["coords"] + ["x", "y", "likelihood"] * len(sure[0]),
    ]
    cells = np.concatenate([places, sure], -1).reshape(FRAMES, -1)
    rows = [[first.format(k), *(f"{x:.6f}" for x in row)] for k, row in enumerate(cells)]
    return "\n".join(",".join(line) for line in heads + rows) + "\n", places


@pytest.mark.parametrize("animals", [["one"], ["fly", "mate"]])
def test_parts_of_deeplabcut_are_bodies_by_their_names(tmp_path, animals) -> None:
    path = tmp_path / "video.csv"
    text, places = deeplabcut(animals, ["nose", "tail"])
    path.write_text(text)
    found = read_recording(path, interval=0.04)
    assert found.unit == "pixels" and found.times[0, 1] == 0.04
    assert np.isnan(found.positions[0, 3, 0]).all()  # of which it is not sure
    seen = np.isfinite(found.positions[0])
    np.testing.assert_allclose(found.positions[0][seen], places[seen], atol=1e-5)
    assert seen.sum() == places.size - 2
    name = "tail" if len(animals) == 1 else "mate tail"
    one = read_recording(path, {"body": name}, 0.04)
    np.testing.assert_allclose(one.positions[0], places[:, -1:], atol=1e-5)
    with pytest.raises(InputError, match="`columns`: the markers are "):
        read_recording(path, {"body": "wing"}, 0.04)


class Evil:
    """What a pickle can hold: a call, made when it is read."""

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, ("true",)


def deeplabcut_hdf5(path: Path, animals: list[str], extra: list[object] | None = None) -> None:
    """The table of :func:`deeplabcut` as pandas writes it to HDF5, by PyTables."""
    lines = [line.split(",") for line in deeplabcut(animals, ["nose", "tail"])[0].splitlines()]
    heads = [line for line in lines if not line[0].isdigit()]
    rows = np.array(lines[len(heads) :], float)
    kind = [("index", "<i8"), ("values_block_0", "<f8", (rows.shape[1] - 1,))]
    columns = [*zip(*(head[1:] for head in heads), strict=True)]
    info = {1: {"names": [head[0] for head in heads], "type": "MultiIndex"}, "index": {}}
    with h5py.File(path, "w") as out:
        group = out.create_group("df_with_missing")
        group.attrs["info"] = np.bytes_(pickle.dumps(info, 0))
        axes = [(1, columns), *(extra or [])]
        group.attrs["non_index_axes"] = np.bytes_(pickle.dumps(axes, 0))
        group["table"] = np.array([(row[0], row[1:]) for row in rows], kind)


@pytest.mark.parametrize("animals", [["one"], ["fly", "mate"]])
def test_a_table_of_deeplabcut_is_the_same_in_hdf5(tmp_path, animals) -> None:
    (tmp_path / "video.csv").write_text(deeplabcut(animals, ["nose", "tail"])[0])
    deeplabcut_hdf5(tmp_path / "video.h5", animals)
    paths = tmp_path / "video.csv", tmp_path / "video.h5"
    text, binary = (read_recording(path, interval=0.04) for path in paths)
    np.testing.assert_array_equal(binary.positions, text.positions)
    np.testing.assert_array_equal(binary.times, text.times)
    assert binary.notes == text.notes and binary.unit == text.unit
    assert only_clip(paths[1]) == paths[1]  # no data set of films


def test_code_in_a_table_of_deeplabcut_is_not_run(tmp_path) -> None:
    deeplabcut_hdf5(tmp_path / "evil.h5", ["one"], [Evil()])
    with pytest.raises(InputError, match=r"its names hold posix.system, which no names need"):
        read_apart(tmp_path / "evil.h5", "tracks", ["h5py"])


def test_a_table_of_deeplabcut_without_a_motion_says_why(tmp_path) -> None:
    path = tmp_path / "CollectedData.csv"
    path.write_text(deeplabcut(["one"], ["nose"], "labeled-data/a/img{}.png")[0])
    with pytest.raises(InputError, match="labels of single pictures are no motion"):
        read_recording(path, interval=0.1)
    path.write_text("scorer,a,a\nbodyparts,nose,nose\n")
    with pytest.raises(InputError, match="no bodyparts, coords and rows"):
        read_recording(path, interval=0.1)
    path.write_text("scorer,a,a\nbodyparts,nose,nose\ncoords,x,likelihood\n0,1,1\n1,2,1\n")
    with pytest.raises(InputError, match="places need x and y"):
        read_recording(path, interval=0.1)
