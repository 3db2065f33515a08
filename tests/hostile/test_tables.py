"""Z6, Z9, Z10: tables, archives and arrays of strangers are read, or refused in one line."""

from __future__ import annotations

import io
import resource
import stat
import struct
import time
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from tests.hostile import mutants
from vidphys.data.formats import bounded, child, foreign, read_recording
from vidphys.errors import InputError

pytestmark = pytest.mark.usefixtures("unchecked")


def said_of(path: Path, interval: float | None = 0.1) -> str:
    """The one line that refuses a file."""
    with pytest.raises(InputError) as caught:
        read_recording(path, interval=interval)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def zeros(shape: str, kind: str = "<f8", count: int = 0) -> bytes:
    """An array of numpy's format that says it has this shape, and has so many bytes."""
    about = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"
    about += " " * (64 - (len(about) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(about)) + about.encode() + bytes(count)


def archive(path: Path, members: dict[str, bytes], links: tuple[str, ...] = ()) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            about = zipfile.ZipInfo(name)
            about.compress_type = zipfile.ZIP_DEFLATED
            mode = stat.S_IFLNK if name in links else stat.S_IFREG
            about.external_attr = (mode | 0o644) << 16
            file.writestr(about, data)
    return path


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({"positions.npy": zeros("(1000000, 100, 100)")}, "'positions' of 1000000 x 100 x 100"),
        ({"positions.npy": zeros("(99999999999, 99999999999, 9)")}, "would fill more than 512 MiB"),
        ({"positions.npy": zeros("(-1, 2, 2)")}, "would fill more"),
        ({"positions.npy": zeros("(4, 1, 2)", count=8)}, "not an npz file of numbers"),
        ({"positions.npy": zeros("(0, 1, 2)")}, "'positions' (0, 1, 2) holds nothing"),
        ({"positions.npy": zeros("(4, 1, 2)", "|O", 64)}, "which are no numbers"),
        ({"positions.npy": zeros("(4, 1, 2)", "<U4", 999)}, "which are no numbers"),
        ({"positions.npy": b"\x93NUMPY\x01\x00\xff\xff{"}, "not an npz file of numbers"),
        ({"positions.npy": b"hello"}, "not an npz file of numbers"),
        ({"positions.npy": zeros("(4,1,2)", count=64), "q.npy": zeros("(1,)")}, "needs either"),
        ({"positions.npy": zeros("(4, 2)", count=64)}, "must be (t, n, d)"),
        ({"positions.npy": zeros("(4,1,2)", count=64), "dt.npy": zeros("(2,)", count=16)}, "size"),
        ({"a.npy": zeros("()")}, "needs either positions or pixels"),
        ({}, "has nothing"),
    ],
)
def test_z09_an_npz_is_held_to_its_headers_before_anything_is_allocated(tmp_path, members, said):
    path = archive(tmp_path / "a.npz", members)
    tracemalloc.start()
    try:
        assert said in said_of(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_z09_what_an_npz_has_beside_its_places_is_not_read(tmp_path):
    good = zeros("(4, 1, 2)", count=64)
    path = archive(tmp_path / "a.npz", {"q.npy": good, "frames.npy": zeros("(99999, 99999, 99)")})
    assert read_recording(path, interval=0.1).positions.shape == (1, 4, 1, 2)


def test_z09_a_parquet_of_equal_values_is_refused_by_its_rows(tmp_path):
    rows = 40_000_000
    column = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array([1.5]))
    pq.write_table(pa.table({"t": column, "x": column}), tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 1e6
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert "a table of 40000000 x 2 numbers would fill more than 512 MiB" in said_of(
        tmp_path / "a.parquet"
    )
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"t": [1.0], "x": [[1.0, 2.0]]}, "column x: holds more than a number in a cell"),
        ({"t": ["a" * 3_000_000] * 100, "x": [1.0] * 100}, "column t: of 100 x 3000000"),
        ({"t": [None, None], "x": [None, None]}, "not"),
        ({f"x{k}": [1.0] for k in range(5000)}, "5000 columns, more than 4096"),
    ],
)
def test_z09_cells_of_a_parquet_are_numbers_or_short(tmp_path, table, said):
    pq.write_table(pa.table(table), tmp_path / "a.parquet")
    assert said in said_of(tmp_path / "a.parquet")


def test_z10_columns_of_one_name_are_refused(tmp_path):
    twice = pa.Table.from_arrays([pa.array([1.0, 2.0])] * 3, names=["t", "x", "x"])
    pq.write_table(twice, tmp_path / "a.parquet")
    assert "two columns are called x" in said_of(tmp_path / "a.parquet")
    (tmp_path / "a.csv").write_text("t,x,x,x\n0,1,2,3\n1,1,2,3\n2,2,3,4\n")
    assert read_recording(tmp_path / "a.csv").positions.shape == (1, 3, 3, 1)
    (tmp_path / "a.csv").write_text("t,x,2 x,x,x\n0,1,2,3,3\n1,1,2,3,3\n2,2,3,4,3\n")
    assert read_recording(tmp_path / "a.csv").positions.shape[1] == 3


def test_z09_a_matlab_file_is_counted_before_it_is_read(tmp_path, monkeypatch):
    savemat(tmp_path / "a.mat", {"t": np.zeros(4_000_000), "x": np.zeros(9)}, do_compression=True)
    monkeypatch.setattr(bounded, "MOST_BYTES", 2**24)
    assert (tmp_path / "a.mat").stat().st_size < 1e6
    assert "more than 16 MiB when unpacked" in said_of(tmp_path / "a.mat")


@pytest.mark.parametrize("name", ["a.parquet", "a.mat"])
@pytest.mark.parametrize(
    ("module", "limit", "value", "said"),
    [
        (foreign, "MEMORY", 2**25, "memory"),
        (foreign, "SECONDS", -1, "processor time"),
        (child, "PATIENCE", 0.001, "hangs"),
    ],
)
def test_z09_what_reads_a_foreign_table_is_held_to_limits(
    tmp_path, monkeypatch, name, module, limit, value, said
):
    columns = {key: np.arange(3_000_000.0) for key in "tx"}
    if name == "a.mat":
        savemat(tmp_path / name, columns)
    else:
        pq.write_table(pa.table(columns), tmp_path / name)
    monkeypatch.setattr(module, limit, value)
    assert said in said_of(tmp_path / name)


def test_z09_a_foreign_table_is_read_apart_as_it_is_here(tmp_path):
    table = {
        "t": np.arange(4.0),
        "n": np.arange(4, dtype=np.int16),
        "seen": np.array([True, False, True, True]),
        "when": np.arange(4).astype("M8[ms]"),
        "word": np.array(["a", "béta", "", "d"]),
    }
    pq.write_table(pa.table(table), tmp_path / "a.parquet")
    held = foreign.read_apart(tmp_path / "a.parquet", "parquet", ["pyarrow"])
    assert list(held) == list(table)
    for key, expected in table.items():
        assert np.array_equal(held[key], expected) and held[key].dtype.kind == expected.dtype.kind


XML = mutants.project()
BOMB = '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9)
)
MARK = "<!-- org.opensourcephysics -->"
SAMPLES = {
    "escape": ({"../../clip.trk": XML.encode()}, ()),
    "absolute": ({"/etc/clip.trk": XML.encode()}, ()),
    "drive": ({"C:\\clip.trk": XML.encode()}, ()),
    "nul": ({"a\0b/clip.trk": XML.encode()}, ()),
    "long": ({"a" * 60000 + ".trk": XML.encode()}, ()),
    "link": ({"clip.trk": b"/etc/passwd"}, ("clip.trk",)),
    "link-of-good": ({"clip.trk": XML.encode()}, ("clip.trk",)),
    "folder": ({"clip.trk/": b""}, ()),
    "none": ({"clip.mp4": b""}, ()),
    "empty": ({}, ()),
    "many": ({f"{k}.jpg": b"" for k in range(10_001)}, ()),
    "zeros": ({"clip.trk": MARK.encode() + bytes(200_000_000)}, ()),
    "blanks": ({"clip.trk": XML.encode() + b" " * 200_000_000}, ()),
    "entities": ({"clip.trk": f"{BOMB}]><a>{MARK}&j;</a>".encode()}, ()),
    "outside": (
        {"clip.trk": f'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>{MARK}<a>&x;</a>'},
        (),
    ),
    "deep": ({"clip.trk": (MARK + "<a>" * 200_000).encode()}, ()),
    "deep-closed": ({"clip.trk": (f"{MARK}" + "<a>" * 90000 + "</a>" * 90000).encode()}, ()),
    "archive": ({"clip.trk": b"PK\3\4" + bytes(99)}, ()),
    "far": ({"clip.trk": XML.replace("[39]", "[999999999999]").encode()}, ()),
    "flat": ({"clip.trk": XML.replace('"xscale" type="double">50', '"xscale">0').encode()}, ()),
    "digits": ({"clip.trk": XML.replace("[39]", f"[{'9' * 5000}]").encode()}, ()),
    "words": ({"clip.trk": XML.replace(">33.3<", ">soon<").encode()}, ()),
}
READ = {"escape", "absolute", "drive", "long"}  # into memory, wherever their names lead


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("ending", [".zip", ".trz"])
def test_z06_an_archive_is_bounded_and_nothing_of_it_is_written(tmp_path, name, ending):
    home = tmp_path / "in" / "side"
    home.mkdir(parents=True)
    members, links = SAMPLES[name]
    path = archive(home / f"a{ending}", {k: bytes(v, "utf-8") if isinstance(v, str) else v
                                         for k, v in members.items()}, links)  # fmt: skip
    began = time.monotonic()
    if name in READ:
        assert read_recording(path).positions.shape == (1, 40, 1, 2)
    else:
        said_of(path, None)
    assert time.monotonic() - began < 10
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [path]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"PK\5\6" + bytes(17),
        b"PK\5\6" + bytes(18),
        b"PK\3\4" + bytes(200),
        zlib.compress(b"a" * 100),
    ],
)
@pytest.mark.parametrize(
    "name", ["a.zip", "a.trz", "a.npz", "a.parquet", "a.mat", "a.trk", "a.xlsx", "a.xls", "a.ods"]
)
def test_z06_what_is_no_archive_is_one_line(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    said_of(tmp_path / name)


def test_z06_a_locked_archive_is_one_line(tmp_path):
    path = archive(tmp_path / "a.zip", {"a.trk": XML.encode()})
    data = bytearray(path.read_bytes())
    for mark, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        data[data.index(mark) + offset] |= 1
    path.write_bytes(data)
    assert "not" in said_of(path)


def long_table(bodies: int) -> str:
    rows = "\n".join(f"{k},{b},{k}.5,{b}" for b in range(bodies) for k in (2 * b, 2 * b + 1))
    return f"t,body,x,y\n{rows}\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (long_table(6000), "frames by bodies of 12000 x 6000 x 2 numbers would fill"),
        ("t,x\n" + "a" * 200_000 + ",1\n", ""),
        ('t,x\n0,"' + "1" * 200_000 + '"\n1,2\n', ""),
        (",".join(f"x{k}" for k in range(6000)) + "\n" + "1," * 5999 + "1\n", "6000 columns"),
        ("t," + "x" * 100_000 + "\n0,1\n1,2\n", "is no name"),
        ("t" + " " * 50_000 + "x\n0 1\n1 2\n2 3\n", ""),
        ("t,x\n" + "nan,1\n" * 50, "no row has a time"),
        ("t,x\n1e999,1\n1e999,2\n", "no row has a time"),
        ("\0\1\2", "not a text of numbers"),
        ("t,x\n" * 10, "no rows of numbers"),
        ('"' * 1000, ""),
    ],
)
def test_z09_z10_texts_that_are_large_or_odd(tmp_path, text, said):
    (tmp_path / "a.csv").write_text(text)
    began = time.monotonic()
    try:
        read_recording(tmp_path / "a.csv", interval=0.1)
        assert not said
    except InputError as error:
        assert said in str(error)
        assert "\n" not in str(error)
    assert time.monotonic() - began < 10


def test_z09_a_text_is_weighed_before_it_is_read(tmp_path):
    with (tmp_path / "a.csv").open("wb") as file:
        file.truncate(2**36)
    tracemalloc.start()
    assert "more than 64 MiB of text" in said_of(tmp_path / "a.csv")
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()
    (tmp_path / "a.trk").hardlink_to(tmp_path / "a.csv")
    said_of(tmp_path / "a.trk")


@pytest.mark.slow
def test_mutants_are_read_or_refused_in_one_line(tmp_path):
    (tmp_path / "a.csv").touch()
    found = {
        number: (path.name, said)
        for number, path, said in mutants.tried_apart(0, 120, tmp_path)
        if said not in ("read", "refused")
    }
    assert not found


def test_a_mutant_can_be_made_again(tmp_path):
    files = mutants.good()
    one, two = (mutants.mutant("a.npz", files["a.npz"], np.random.default_rng(7)) for _ in range(2))
    with zipfile.ZipFile(io.BytesIO(files["a.npz"])) as file:
        assert file.namelist() == ["positions.npy", "times.npy"]
    assert len(one) == len(two)
