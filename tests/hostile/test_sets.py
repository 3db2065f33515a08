"""Z9, Z10: data sets of strangers in HDF5, Arrow and Parquet are read by a child held to limits."""

from __future__ import annotations

import json
import resource
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.hostile.mutants import read_whole, sets
from vidphys.data.formats import bounded, child
from vidphys.data.sets import apart, read_set
from vidphys.errors import InputError

LONG = 6_000_000


def said_of(read, path: Path) -> str:
    """The one line that refuses a data set, before much memory is taken."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB
    return str(caught.value)


def hdf5(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file.create_dataset("a/frames", data=np.zeros((4, 8, 8, 3), np.uint8))
        for name, values in columns.items():
            file.create_dataset(f"a/{name}", data=values, compression="gzip")
    return folder / "a.h5"


def arrow(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    count = len(next(iter(columns.values())))
    nothing = [pa.nulls(count, pa.binary()), pa.nulls(count, pa.string())]
    cells = pa.StructArray.from_arrays(nothing, ["bytes", "path"])
    table = pa.table({"image": cells, **columns})
    (folder / "state.json").write_text(json.dumps({"_data_files": [{"filename": "a.arrow"}]}))
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.ipc.new_stream(str(folder / "a.arrow"), table.schema, options=options) as out:
        out.write_table(table)
    return folder


def parquet(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    pq.write_table(pa.table(columns), folder / "a.parquet")
    return folder / "a.parquet"


def rows(path: Path) -> object:
    return apart.rows_of(path, "parquet")


KINDS = {"hdf5": (hdf5, read_set), "arrow": (arrow, read_set), "parquet": (parquet, rows)}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("module", "limit", "value", "said"),
    [
        (apart, "MEMORY", 2**25, "memory"),
        (apart, "SECONDS", -1, "processor time"),
        (child, "PATIENCE", 0.001, "hangs"),
        (bounded, "MOST_BYTES", 2**24, "would fill more than 16 MiB; give fewer of them"),
    ],
)
def test_z09_what_reads_a_set_is_held_to_limits(
    tmp_path, monkeypatch, kind, module, limit, value, said
):
    write, read = KINDS[kind]
    path = write(tmp_path, {"t": np.zeros(LONG), "x": np.zeros(LONG)})
    monkeypatch.setattr(module, limit, value)
    assert said in said_of(read, path)


def test_z09_frames_of_an_hdf5_are_held_to_their_size_and_to_memory(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        huge = {"dtype": np.uint8, "chunks": (1, 9000, 5000, 3), "compression": "gzip"}
        file.create_dataset("a/frames", (9, 9000, 5000, 3), **huge)
    assert "a frame has more than 40000000 pixels" in said_of(read_set, tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset("a/frames", data=np.zeros((64, 999, 999, 3), np.uint8),
                            chunks=(64, 999, 999, 3), compression="gzip")  # fmt: skip
    (file,) = read_set(tmp_path / "b.h5").files
    monkeypatch.setattr(apart, "MEMORY", 2**26)
    said_of(lambda _: list(file.source.read()[2]), tmp_path / "b.h5")


def test_z10_a_chunk_that_is_hurt_is_told_after_the_frames_before_it(tmp_path):
    path = tmp_path / "a.h5"
    random = np.random.default_rng(0).integers(0, 255, (6, 40, 40, 3), dtype=np.uint8)
    with h5py.File(path, "w") as file:
        file.create_dataset("a/frames", data=random, chunks=(1, 40, 40, 3), fletcher32=True)
        where = file["a/frames"].id.get_chunk_info(4)
    data = bytearray(path.read_bytes())
    data[where.byte_offset + 99] ^= 1
    path.write_bytes(data)
    (file,) = read_set(path).files
    frames = file.source.read()[2]
    for expected in random[:4]:
        np.testing.assert_array_equal(next(frames)[0], expected)
    assert "not an HDF5 file" in said_of(lambda _: next(frames), path)


def test_z10_what_a_list_of_files_says_is_read_or_refused(tmp_path):
    home = arrow(tmp_path, {"t": np.zeros(2)})
    for text in ("[]", "{}", '{"_data_files": []}', '{"_data_files": [{}]}', '{"_data_files": 3}'):
        (home / "state.json").write_text(text)
        said_of(read_set, home)
    (home / "dataset_dict.json").write_text('{"splits": 3}')
    said_of(read_set, home)


def test_z10_sets_that_mutants_are_made_of_are_read(tmp_path):
    files = sets()
    for name in ("a.h5", "data.arrow", "state.json"):
        (tmp_path / name).write_bytes(files[name])
    read_whole(tmp_path)
    read_whole(tmp_path / "a.h5")
