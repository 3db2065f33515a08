"""Files of motion capture and detectors; clocks of robots; pandas' JSON."""

from __future__ import annotations

import json
from pathlib import Path

import c3d
import numpy as np
import pytest

from vidphys.data.formats import Recording, read_recording
from vidphys.data.formats.stamps import moments, unrounded
from vidphys.errors import InputError

FRAMES = 12
RATE = 120
T = np.arange(FRAMES) / RATE
BALL = np.stack([100 + 300 * T, 2000 + 2500 * T - 4903 * T**2, 30 + 0 * T], 1)
TIP = BALL + [5.0, 0.0, 0.0]
TIP[3] = np.nan


def cells(*places: np.ndarray, between: str, head: bool = True) -> str:
    """Rows of a frame, a time and the places; unseen ones empty."""
    lines = []
    for k in range(FRAMES):
        row = [str(k + 1), f"{T[k]:.5f}"] if head else []
        row += ["" if x != x else f"{x:.4f}" for at in places for x in at[k]]
        lines.append(between.join(row))
    return "\n".join(lines) + "\n"


def opensim() -> str:
    keys = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate"]
    told = f"{RATE}.00 {RATE}.00 {FRAMES} 2 mm {RATE}.00".split()
    return "\n".join(
        [
            "PathFileType\t4\t(X/Y/Z)\ttoss.trc",
            "\t".join(keys),
            "\t".join(told),
            "Frame#\tTime\tball\t\t\ttip\t\t",
            "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
            "",
            cells(BALL, TIP, between="\t"),
        ]
    )


def qualisys() -> str:
    tip = np.where(np.isnan(TIP), 0.0, TIP)
    return (
        f"NO_OF_FRAMES\t{FRAMES}\nNO_OF_MARKERS\t2\nFREQUENCY\t{RATE}\nDESCRIPTION\t--\n"
        "TIME_STAMP\t2021-01-01, 12:00:00\nMARKER_NAMES\tball\ttip\n"
        + cells(BALL, tip, between="\t", head=False).replace("\n", "\t\n")
    )


def motive() -> str:
    def turned(values: str) -> str:  # what a rigid body has beside its place
        return ",".join(f"{values},{x}" for x in ("X", "Y", "Z"))

    angles = np.zeros((FRAMES, 3))
    return (
        f"Format Version,1.23,Take Name,toss,Export Frame Rate,{RATE}.000000,Length Units,"
        "Millimeters,Coordinate Space,Global\n\n"
        f",,{','.join(3 * ['Rigid Body'] + 6 * ['Marker'])}\n"
        f",,{','.join(3 * ['ball'] + 3 * ['ball'] + 3 * ['tip'])}\n"
        f",,{','.join(9 * ['A:1'])}\n"
        f",,{','.join(3 * ['Rotation'] + 6 * ['Position'])}\n"
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z,X,Y,Z\n" + cells(angles, BALL, TIP, between=",")
    )


def vicon() -> str:
    heads = ",,ball,,,tip,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
    return f"Trajectories\n{RATE}\n{heads}{cells(BALL, TIP, between=',')}\nModel Outputs\n"


def qualisys_with_times() -> str:
    heads = "\t".join(f"{name} {axis}" for name in ("ball", "tip") for axis in "XYZ")
    head, _ = qualisys().split("tip\n")
    return f"{head}tip\nFrame\tTime\t{heads}\n" + cells(BALL, TIP, between="\t")


FILES = {
    "toss.trc": opensim,
    "toss.tsv": qualisys,
    "times.tsv": qualisys_with_times,
    "motive.csv": motive,
    "vicon.csv": vicon,
}


def read(folder: Path, text: str, name: str, **options: object) -> Recording:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_recording(path, **options)


@pytest.mark.parametrize("name", FILES)
def test_markers_of_motion_capture_are_bodies(tmp_path, name) -> None:
    found = read(tmp_path, FILES[name](), name)
    np.testing.assert_allclose(found.positions[0], np.stack([BALL, TIP], 1), atol=1e-3)
    np.testing.assert_allclose(found.times[0], T, atol=1e-9)
    assert (found.length, found.unit) == ("mm", "world")
    assert found.notes == ("2 markers of motion capture: ball, tip; 120 frames a second",)


@pytest.mark.parametrize("name", FILES)
def test_some_markers_may_be_taken(tmp_path, name) -> None:
    found = read(tmp_path, FILES[name](), name, columns={"body": "tip"})
    np.testing.assert_allclose(found.positions[0, :, 0], TIP, atol=1e-3)
    with pytest.raises(InputError, match="the markers are ball, tip; take some"):
        read(tmp_path, FILES[name](), name, columns={"body": "ball,tail"})


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_ends_early_is_refused_in_one_line(tmp_path, name) -> None:
    lines = FILES[name]().splitlines()
    first = next(k for k, line in enumerate(lines) if "2000.0000" in line)
    for count in range(1, first + 1):
        with pytest.raises(InputError) as caught:
            read(tmp_path, "\n".join(lines[:count]), name)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="'two' among the places of markers is no number"):
        read(tmp_path, FILES[name]().replace("2000.0000", "two"), name)


U, V = 320 + 100 * np.cos(9 * T), 200 + 40 * T


def boxes(names: str, *columns: np.ndarray) -> str:
    values = zip(range(FRAMES), *columns, strict=True)
    return f"frame,{names}\n" + "".join(",".join(map(str, row)) + "\n" for row in values)


@pytest.mark.parametrize(
    "text",
    [
        boxes("xmin,ymin,xmax,ymax", U - 9, V - 4, U + 9, V + 4),
        boxes("bbox_left,bbox_top,bbox_width,bbox_height", U - 9, V - 4, U * 0 + 18, U * 0 + 8),
        boxes("x_min,y_min,w,h", U - 9, V - 4, U * 0 + 18, U * 0 + 8),
        "".join(
            f"{k},1,{u - 9},{v - 4},18,8,1,-1,-1,-1\n"
            for k, (u, v) in enumerate(zip(U, V, strict=True))
        ),
    ],
    ids=["edges", "sides", "mixed", "MOTChallenge"],
)
def test_a_box_stands_for_its_middle(tmp_path, text) -> None:
    found = read(tmp_path, text, "boxes.csv", interval=1 / RATE)
    np.testing.assert_allclose(found.positions[0, :, 0], np.stack([U, V], 1), atol=1e-9)
    assert found.unit == "pixels"


def test_boxes_that_do_not_end_in_minus_one_are_not_motchallenges(tmp_path) -> None:
    rows = "".join(
        f"{k},1,{u},{v},18,8,1,-1,-1,{k % 3}\n" for k, (u, v) in enumerate(zip(U, V, strict=True))
    )
    assert "MOTChallenge" not in str(read(tmp_path, rows, "t.csv").notes)


@pytest.mark.parametrize(("unit", "second"), [("ns", 1e9), ("µs", 1e6), ("ms", 1e3)])
def test_whole_numbers_since_1970_are_seconds(tmp_path, unit, second) -> None:
    stamps = np.rint((1.7e9 + np.arange(FRAMES) * 0.025) * second)
    rows = "".join(f"{s:.0f},{u}\n" for s, u in zip(stamps, U, strict=True))
    found = read(tmp_path, "time,x\n" + rows, "ros.csv")
    np.testing.assert_allclose(found.times[0], np.arange(FRAMES) * 0.025, atol=1e-6)
    assert f"in {unit} since 1970" in found.notes[0]


def test_clock_times_may_have_a_decimal_comma_and_no_hours() -> None:
    for words in (["0:00:59,96", "0:01:00,04"], ["00:59.96", "01:00.04"]):
        np.testing.assert_allclose(moments(np.array(words)), [0.0, 0.08], atol=1e-9)


def test_a_fourth_number_of_a_clock_time_is_hundredths_or_counts_frames() -> None:
    words = np.array(["0:00:01:96", "0:00:02:00", "0:00:02:03"])
    np.testing.assert_allclose(moments(words), [0.0, 0.04, 0.07], atol=1e-9)
    with pytest.raises(ValueError, match="counts frames"):
        moments(np.array(["00:00:01:23", "00:00:01:24", "00:00:02:00", "00:00:02:01"]))


@pytest.mark.parametrize("written", [np.round, lambda x, n: np.floor(x * 10**n) / 10**n])
@pytest.mark.parametrize("rate", [24, 29.97, 30, 60, 240])
def test_times_of_few_digits_are_even_again(written, rate) -> None:
    frames = np.delete(np.arange(90), [7, 8, 40])
    for digits in (2, 3):
        if rate * 0.1**digits > 1:
            continue  # a clock coarser than the frames
        even, quantum = unrounded(written(frames / rate, digits))
        assert np.abs(np.diff(even) * rate - np.diff(frames)).max() < 0.01
        assert quantum in (0.0, 10.0**-digits)  # none where it is fine enough


def test_times_that_are_uneven_stay_so() -> None:
    late = np.random.default_rng(0).uniform(-0.3, 0.3, 90) / 30
    for times in (np.zeros(9), np.arange(9)[::-1] / 100, np.r_[np.nan, np.arange(9) / 100]):
        np.testing.assert_array_equal(unrounded(times)[0], times)
    in_turn = np.cumsum(np.tile([0.05, 0.03], 45))
    for times in (np.arange(90) / 30 + late, np.round(np.arange(90) / 30 + late, 3), in_turn):
        found, quantum = unrounded(times)
        assert quantum == 0 and (found == times).all()


def test_the_brightness_that_a_tracker_calls_mass_is_none(tmp_path) -> None:
    def table(mass: np.ndarray) -> str:
        both = zip(range(FRAMES), U, V, mass, strict=True)
        return "t,x,y,mass,particle\n" + "".join(
            f"{k / RATE},{u},{v},{m},{n}\n" for k, u, v, m in both for n in (0, 1)
        )

    assert read(tmp_path, table(300 + np.arange(FRAMES)), "trackpy.csv").mass is None
    assert read(tmp_path, table(np.full(FRAMES, 2.5)), "masses.csv").mass.tolist() == [[2.5, 2.5]]


def test_the_orientation_of_a_robot_is_no_second_body(tmp_path) -> None:
    names = "time," + ",".join(f"pose.{p}.{a}" for p in ("position", "orientation") for a in "xyz")
    rows = "".join(f"{t},{u},{v},{0.5 + t},0,0,0.1\n" for t, u, v in zip(T, U, V, strict=True))
    assert read(tmp_path, f"{names}\n{rows}", "ros.csv").positions.shape == (1, FRAMES, 1, 3)


def test_json_as_pandas_writes_it_is_a_table(tmp_path) -> None:
    table = [{"t": t, "x": u, "y": v} for t, u, v in zip(T, U, V, strict=True)]
    split = {"columns": list(table[0]), "index": [], "data": [[*row.values()] for row in table]}
    by_row = {name: {str(k): row[name] for k, row in enumerate(table)} for name in table[0]}
    lines = "\n".join(map(json.dumps, table)) + "\n\n"
    for text, name in (
        (json.dumps(split), "split.json"),
        (json.dumps(by_row), "table.json"),
        (lines, "rows.jsonl"),
        (lines, "rows.json"),
    ):
        found = read(tmp_path, text, name)
        np.testing.assert_allclose(found.positions[0, :, 0], np.stack([U, V], 1))
        np.testing.assert_allclose(found.times[0], T)
    with pytest.raises(InputError, match="not JSON"):
        read(tmp_path, lines + '{"t": 3', "cut.jsonl")


def test_an_array_alone_is_a_table_or_places(tmp_path) -> None:
    places = np.stack([BALL, TIP], 1)
    for held in (places, places[None]):
        np.save(tmp_path / "places.npy", held)
        found = read_recording(tmp_path / "places.npy", interval=1 / RATE)
        np.testing.assert_array_equal(found.positions[0], places)
        np.testing.assert_allclose(found.times[0], T)
    np.save(tmp_path / "rows.npy", np.stack([T, U, V], 1))
    found = read_recording(tmp_path / "rows.npy")
    np.testing.assert_allclose(found.positions[0, :, 0], np.stack([U, V], 1))
    np.save(tmp_path / "film.npy", np.zeros((5, 4, 4, 3), np.uint8))
    with pytest.raises(InputError, match="holds bytes, as frames do"):
        read_recording(tmp_path / "film.npy")
    np.save(tmp_path / "any.npy", np.array([{"x": 1}], object), allow_pickle=True)
    with pytest.raises(InputError, match="not an npy file of numbers"):
        read_recording(tmp_path / "any.npy")


def c3d_file(path: Path, labels: list[str]) -> np.ndarray:
    """A file as a motion capture system writes it; its places ``(frames, markers, 3)``."""
    places = np.random.default_rng(0).uniform(-900, 900, (FRAMES, len(labels), 3))
    places[4, 1] = np.nan
    writer = c3d.Writer(point_rate=120.0, analog_rate=0.0)
    for frame in places:
        seen = np.isfinite(frame).all(-1, keepdims=True)
        points = np.concatenate([np.nan_to_num(frame), np.where(seen, 0.5, -1.0), 0 * seen], 1)
        writer.add_frames([(points.astype(np.float32), np.zeros((0, 0)))])
    writer.set_point_labels(labels)
    with path.open("wb") as out:
        writer.write(out)
    return places


def test_markers_of_a_c3d_file_are_bodies_with_its_rate_and_unit(tmp_path) -> None:
    path = tmp_path / "swing.c3d"
    places = c3d_file(path, ["BOB", "PIVOT"])
    found = read_recording(path)
    assert found.length == "mm" and found.notes == (
        "2 markers of motion capture: BOB, PIVOT; 120 frames a second",
    )
    np.testing.assert_allclose(found.positions[0], places, atol=1e-4)
    np.testing.assert_allclose(found.times[0], np.arange(FRAMES) / 120)
    bob = read_recording(path, {"body": "BOB"}, 0.01)
    np.testing.assert_array_equal(bob.positions[0], found.positions[0][:, :1])
    assert bob.times[0, 1] == 0.01
    with pytest.raises(InputError, match="the markers are BOB, PIVOT"):
        read_recording(path, {"body": "HEAD"})
    path.write_bytes(path.read_bytes().replace(b"PIVOT", b"PIV\xd6T"))
    assert "BOB, PIVÖT" in read_recording(path).notes[0]


def test_a_hurt_c3d_file_is_refused_in_one_line(tmp_path) -> None:
    path = tmp_path / "swing.c3d"
    c3d_file(path, ["BOB", "PIVOT"])
    whole = path.read_bytes()
    for name, held in {"cut": whole[:600], "none": b"", "text": b"t,x\n0,1\n" * 99}.items():
        hurt = tmp_path / f"{name}.c3d"
        hurt.write_bytes(held)
        with pytest.raises(InputError, match="not a C3D file|no marker is seen"):
            read_recording(hurt)
    long = bytearray(whole)
    long[8:10] = b"\xff\xff"  # frames that the header tells of, and that are not there
    (tmp_path / "long.c3d").write_bytes(long)
    found = read_recording(tmp_path / "long.c3d")
    assert "tells of 65535 frames, and ends after" in found.notes[1]
    assert np.isfinite(found.positions[0]).all(-1).sum() == 2 * FRAMES - 1  # not of the padding
