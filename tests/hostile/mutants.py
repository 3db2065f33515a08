"""Files of strangers, made here: good ones, and what becomes of them by seeded mishaps.

``python -m tests.hostile.mutants --count 5000`` reads so many, some hundreds in a process each, and
says what was neither read nor refused in one line; `make hostile` calls it.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import resource
import struct
import sys
import tempfile
import time
import traceback
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from vidphys.errors import InputError

SECONDS, BYTES = 10, 2 * 10**9
TIMES = np.arange(40) / 30
PLACES = np.stack([np.sin(TIMES), 1 - 4.9 * TIMES**2, np.cos(TIMES), TIMES], -1)
EXTREME = (
    *("inf", "-inf", "nan", "1e308", "-1e308", "1e-320", "0", "-0", "", " ", "null", "true", "[]"),
    *("99999999999999999999", "9" * 400, "0x10", "1_0", "１", "-1", "1e999", '"', "{", "\t", "\0"),
    *("<a>", "&lt;", "&x;", "t", "x", "x1", "body", "frame", ";", "2024-01-01", "12:00:00"),
)


def good() -> dict[str, bytes]:
    """A file of each kind that is read."""
    import openpyxl
    import pyarrow as pa
    import pyarrow.parquet as pq
    import torch
    from safetensors.torch import save
    from scipy.io import savemat

    rows = np.column_stack([TIMES, PLACES])
    lines = "\n".join(",".join(f"{x:.6g}" for x in row) for row in rows)
    arrays, table, matlab, book = io.BytesIO(), io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.savez(arrays, positions=PLACES.reshape(1, 40, 2, 2), times=TIMES)
    names = ("t", "x1", "y1", "x2", "y2")
    pq.write_table(pa.table(dict(zip(names, rows.T, strict=True))), table)
    savemat(matlab, {"t": TIMES, "x": PLACES[:, 0], "s": {"y": PLACES[:, 1]}}, do_compression=True)
    sheets = openpyxl.Workbook()
    for row in (names, *rows.tolist()):
        sheets.active.append(row)
    sheets.save(book)
    xml = project()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/clip.trk", xml)
    pairs = zip(TIMES, rows[:, 1], strict=True)
    long = "\n".join(f"{t:.4g}\t{b}\t{x:.4g}\t2" for t, x in pairs for b in "ab")
    return {
        "a.csv": f"t,x1,y1,x2,y2\n{lines}\n".encode(),
        "long.tsv": f"time (s)\tbody\tx [cm]\ty [cm]\n{long}\n".encode(),
        "plain.txt": lines.replace(",", "   ").replace(".", ",").encode("utf-16"),
        "a.npz": arrays.getvalue(),
        "a.parquet": table.getvalue(),
        "a.mat": matlab.getvalue(),
        "a.xlsx": book.getvalue(),
        "a.trk": xml.encode(),
        "a.trz": packed.getvalue(),
        "specification.json": json.dumps(specification()).encode(),
        "dataset.json": json.dumps({"clips": [{"file": "a.csv", "mass": [1.0]}]}).encode(),
        "a.safetensors": save({"w": torch.arange(12.0).reshape(3, 4), "b": torch.zeros(3)}),
        **sets(),
    }


def sets() -> dict[str, bytes]:
    """What data sets are stored in."""
    import cv2
    import h5py
    import pyarrow as pa
    import pyarrow.parquet as pq

    png = cv2.imencode(".png", np.full((8, 8, 3), 99, np.uint8))[1].tobytes()
    shown = [{"bytes": png, "path": None}] * 6
    table = pa.table({
        "image": shown, "clip": [0, 0, 0, 1, 1, 1], "room": list("aabbcc"),
        "timestamp": TIMES[:6], "pixels": [[[x, 1.0]] for x in TIMES[:6]], "far": [[1], []] * 3,
    })  # fmt: skip
    stream, parquet, hdf = io.BytesIO(), io.BytesIO(), io.BytesIO()
    with pa.ipc.new_stream(stream, table.schema) as out:
        out.write_table(table)
    pq.write_table(table, parquet)
    with h5py.File(hdf, "w") as file:
        group = file.create_group("a")
        shape = (6, 8, 8, 3)
        group.create_dataset("frames", data=np.zeros(shape, np.uint8), compression="gzip")
        group["pixels"], group["times"] = PLACES[:6].reshape(6, 2, 2), TIMES[:6]
        group.attrs["split"] = "train"
    return {
        "a.h5": hdf.getvalue(),
        "data.arrow": stream.getvalue(),
        "rows.parquet": parquet.getvalue(),
        "state.json": json.dumps({"_data_files": [{"filename": "data.arrow"}]}).encode(),
    }


def read_whole(path: Path) -> None:
    """A data set with all frames of its clips."""
    from vidphys.data.sets import read_set

    for file in read_set(path).files:
        assert file.source is not None
        for _ in file.source.read()[2]:
            pass


def read_stream(path: Path) -> None:
    """The set of which this is one of the two files."""
    files = sets()
    home = path.parent / f"of {path.name}"
    home.mkdir(exist_ok=True)
    for name in ("data.arrow", "state.json"):
        (home / name).write_bytes(path.read_bytes() if name == path.name else files[name])
    read_whole(home)


def read_rows(path: Path) -> None:
    """The rows of a Parquet file, with their pictures."""
    from vidphys.data.sets.apart import cells_of, rows_of

    count = rows_of(path, "parquet").count
    for _ in cells_of(path, "parquet", "image", range(count)):
        pass


def specification() -> dict:
    from dynamics import terms
    from vidphys.diagnose.explanations.specification import as_specification

    term = terms.Hamiltonian(
        potentials=(terms.Trap(4.0, (0.0, 1.0)), terms.Uniform((0.0, -9.0))),
        ports=(terms.Drag(rate=0.1),),
    )
    return as_specification(term, 1, (0.0, 0.0), {"trap: k": (4.0, 0.1)}, True, 0.04)


def project() -> str:
    """A project of Tracker with one mass."""
    home = "org.opensourcephysics.cabrillo.tracker"

    def value(name: str, held: object) -> str:
        return f'<property name="{name}" type="double">{held}</property>'

    def held(name: str, inside: str, kind: str = "x") -> str:
        inside = f'<object class="{kind}">{inside}</object>'
        return f'<property name="{name}" type="object">{inside}</property>'

    marks = "".join(
        held(f"[{k}]", value("x", 10 + k) + value("y", 90 - k * k / 20)) for k in range(40)
    )
    axes = "".join(
        value(name, x)
        for name, x in (("xorigin", 3), ("yorigin", 4), ("xscale", 50), ("yscale", 50))
    )
    data = '<property name="framedata" type="array">{}</property>'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><object class="{home}.TrackerPanel">'
        + held("videoclip", value("startframe", 0))
        + held("clipcontrol", value("delta_t", 33.3))
        + held("coords", data.format(held("[0]", axes)))
        + f'<property name="tracks"><object class="{home}.PointMass">'
        + value("mass", 1.0)
        + data.format(marks)
        + "</object></property></object>"
    )


def mutant(name: str, data: bytes, random: np.random.Generator) -> bytes:
    """What became of a file; of an archive or a compressed stream sometimes what is in it."""
    if name.endswith((".npz", ".trz", ".xlsx")) and random.random() < 0.6:
        packed = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(packed, "w") as new:
            for member in old.namelist():
                new.writestr(
                    member, hurt(old.read(member), member.endswith((".trk", ".xml")), random)
                )
        return packed.getvalue()
    if name.endswith(".mat") and random.random() < 0.6:
        kind, size = struct.unpack("<II", data[128:136])
        inside = zlib.compress(hurt(zlib.decompress(data[136 : 136 + size]), False, random))
        return data[:128] + struct.pack("<II", kind, len(inside)) + inside + data[136 + size :]
    return hurt(data, name.endswith((".csv", ".tsv", ".txt", ".trk", ".json")), random)


def hurt(data: bytes, text: bool, random: np.random.Generator) -> bytes:
    """One to eight mishaps."""
    for _ in range(int(random.integers(1, 9))):
        if not data:
            return data
        ways = [flip, cut, twice, swapped, wide] + ([word, word, word, line] if text else [])
        data = ways[int(random.integers(len(ways)))](data, random)
    return data


def flip(data: bytes, random: np.random.Generator) -> bytes:
    at = int(random.integers(len(data)))
    return data[:at] + bytes([int(random.integers(256))]) + data[at + 1 :]


def wide(data: bytes, random: np.random.Generator) -> bytes:
    """Four bytes as a size would be that is far off."""
    at = int(random.integers(len(data)))
    value = int(random.choice([0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x10000, 0x80000000]))
    return data[:at] + struct.pack("<I", value) + data[at + 4 :]


def cut(data: bytes, random: np.random.Generator) -> bytes:
    return data[: int(random.integers(len(data)))] if random.random() < 0.3 else data


def twice(data: bytes, random: np.random.Generator) -> bytes:
    a, b = sorted(random.integers(0, len(data), 2).tolist())
    return data[:b] + data[a : min(b, a + 2000)] + data[b:]


def swapped(data: bytes, random: np.random.Generator) -> bytes:
    a, b = sorted(random.integers(0, len(data), 2).tolist())
    return data[:a] + data[b:] + data[a:b]


def word(data: bytes, random: np.random.Generator) -> bytes:
    """A number or a word by another one."""
    import re

    found = list(re.finditer(rb"[\w.+-]+", data))
    if not found:
        return data
    one = found[int(random.integers(len(found)))]
    other = EXTREME[int(random.integers(len(EXTREME)))]
    return data[: one.start()] + other.encode() + data[one.end() :]


def line(data: bytes, random: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    k = int(random.integers(len(lines)))
    other = lines[int(random.integers(len(lines)))]
    return b"\n".join([*lines[:k], other, *lines[k + int(random.integers(3)) :]])


def reader_of(name: str) -> Callable[[Path], object]:
    """What a verb reads such a file by."""
    from encoders.tensors import read_tensors
    from vidphys.data.formats import read_recording
    from vidphys.data.sets.folder import read_manifest
    from vidphys.data.video import ClipSelection, open_video
    from vidphys.diagnose.explanations.specification import read_specification

    if name.endswith((".avi", ".mp4", ".mkv")):
        return lambda path: open_video(path, ClipSelection(rate=25.0))
    return {
        "specification.json": read_specification,
        "dataset.json": read_manifest,
        "a.safetensors": read_tensors,
        "a.h5": read_whole,
        "data.arrow": read_stream,
        "state.json": read_stream,
        "rows.parquet": read_rows,
    }.get(name, lambda path: read_recording(path, interval=0.1))


def outcome(path: Path) -> str:
    """``read``, ``refused`` or what went wrong."""
    read = reader_of(path.name)
    began = time.monotonic()
    try:
        read(path)
        found = "read"
    except InputError as error:
        found = "refused" if "\n" not in str(error) else f"several lines: {error}"
    except ValueError as error:  # of stages, which know no InputError
        told = path.name.endswith(".safetensors") and str(path) in str(error)
        found = "refused" if told else "".join(traceback.format_exception(error))
    except BaseException as error:
        found = "".join(traceback.format_exception(error))
    if time.monotonic() - began > SECONDS:
        found = f"{time.monotonic() - began:.0f} s"
    if (most := most_memory()) > BYTES:
        found = f"{most >> 20} MiB at most so far"
    return found


def most_memory() -> int:
    """Bytes that this process held at most; of a new one, without those of its parent."""
    status = Path("/proc/self/status")
    if not status.is_file():
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
    return 1024 * int(line.split()[1])


def tried_apart(first: int, count: int, folder: Path) -> list[tuple[int, Path, str]]:
    """As :func:`tried`, in a process of its own, whose memory nothing else has used."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply_async(_listed, (first, count, folder)).get(SECONDS * count)


def _listed(first: int, count: int, folder: Path) -> list[tuple[int, Path, str]]:
    return list(tried(first, count, folder))


def clips() -> dict[str, bytes]:
    """Clips of several containers."""
    import cv2

    made = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, codec in (("a.avi", "MJPG"), ("a.mp4", "mp4v"), ("a.mkv", "FFV1")):
            path = str(Path(folder) / name)
            writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*codec), 25.0, (64, 48))
            for k in range(12):
                writer.write(np.full((48, 64, 3), 20 * k, np.uint8))
            writer.release()
            made[name] = Path(path).read_bytes()
    return made


def tried(
    first: int, count: int, folder: Path, files: dict[str, bytes] | None = None
) -> Iterator[tuple[int, Path, str]]:
    """So many mutants, each with its number and what came of it."""
    files = good() if files is None else files
    names = list(files)
    for number in range(first, first + count):
        name = names[number % len(names)]
        path = folder / name
        path.write_bytes(mutant(name, files[name], np.random.default_rng(number)))
        yield number, path, outcome(path)


def _some(first: int, count: int, of_clips: bool) -> dict[str, int]:
    counts: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "a.csv").touch()
        files = clips() if of_clips else None
        for number, path, found in tried(first, count, Path(folder), files):
            if found not in ("read", "refused"):
                print(f"--- mutant {number}, {path.name}\n{found}", flush=True)
            key = found if found in ("read", "refused") else "WRONG"
            counts[key] = counts.get(key, 0) + 1
    return counts


def main() -> int:
    asked = argparse.ArgumentParser()
    asked.add_argument("--count", type=int, default=5000)
    asked.add_argument("--first", type=int, default=0)
    asked.add_argument("--clips", action="store_true", help="hurt clips instead of the others")
    options = asked.parse_args()
    total: dict[str, int] = {}
    context = multiprocessing.get_context("spawn")
    for first in range(options.first, options.first + options.count, 500):
        count = min(500, options.first + options.count - first)
        with context.Pool(1) as pool:  # a crash is a pool that never answers
            try:
                found = pool.apply_async(_some, (first, count, options.clips)).get(SECONDS * count)
            except multiprocessing.TimeoutError:
                found = {"CRASHED": 1}
        for key, value in found.items():
            total[key] = total.get(key, 0) + value
    print(json.dumps(total))
    return 0 if set(total) <= {"read", "refused"} else 1


if __name__ == "__main__":
    sys.exit(main())
