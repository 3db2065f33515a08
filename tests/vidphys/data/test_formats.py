"""Tables as they are found: dialects, headers, units, clocks; files of Tracker, MATLAB, Excel."""

import importlib.util
import os
import zipfile
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from vidphys.data.formats import read_recording, read_table
from vidphys.data.formats.names import meaning_of
from vidphys.errors import InputError

REAL = os.environ.get("VIDPHYS_REAL")
real = pytest.mark.skipif(REAL is None, reason="set VIDPHYS_REAL to the folder of recordings")
T = np.arange(40) * 0.04
X, Y = np.cos(2 * T) + 0.3 * T, 1 + 2 * T - 4.905 * T**2
VX = -2 * np.sin(2 * T) + 0.3


def rows(*columns, between=",", comma=False, digits=9):
    lines = (between.join(f"{x:.{digits}g}" for x in row) for row in zip(*columns, strict=True))
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


def read(folder, text, name="t.csv", encoding="utf-8", **options):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return read_recording(path, **options)


# dialects: every one is the same motion of one body in the plane

SAME = {
    "commas": "t,x,y\n" + rows(T, X, Y),
    "semicolons": "t;x;y\n" + rows(T, X, Y, between=";"),
    "decimal commas": "t;x;y\n" + rows(T, X, Y, between=";", comma=True),
    "decimal commas, tabs": "t\tx\ty\n" + rows(T, X, Y, between="\t", comma=True),
    "decimal commas, blanks": "t x y\n" + rows(T, X, Y, between="  ", comma=True),
    "no names": rows(T, X, Y, between=" "),
    "no names, commas": rows(T, X, Y),
    "trailing delimiter": "t;x;y;\n" + rows(T, X, Y, between=";").replace("\n", ";\n"),
    "quoted": '"t","x","y"\n' + rows(T, X, Y, between='","').replace("\n", '"\n"').join('""')[:-1],
    "comments": "# made by hand\n# fps: 25\n\nt,x,y\n# start\n" + rows(T, X, Y),
    "commented names": "# a pendulum\n# t x y\n" + rows(T, X, Y, between=" "),
    "Excel's": "sep=;\r\nt;x;y\r\n" + rows(T, X, Y, between=";", comma=True).replace("\n", "\r\n"),
    "title": "mass_A\t\t\nt\tx\ty\n" + rows(T, X, Y, between="\t"),
    "one of several": "#multi:\n\tcm A\t\nt\tx\ty\n" + rows(T, X, Y, between="\t"),
    "rates beside": "t,x,vx,y,note\n" + rows(T, X, VX, Y, T).replace("\n", "k\n"),
    "frame too": "frame,time,x,y\n" + rows(np.arange(40), T, X, Y),
    "frame, no names": rows(np.arange(40), T, X, Y, between="\t"),
    "order": "y,x,t\n" + rows(Y, X, T),
    "milliseconds": "t/ms, x, y\n" + rows(1000 * T, X, Y),
    "whole milliseconds": "time,x,y\n" + rows(np.round(1000 * T), X, Y),
    "German": "Zeit [s];x [m];y [m]\n" + rows(T, X, Y, between=";", comma=True),
    "blanks in names": "Time (s)  X pos (m)  Y pos (m)\n" + rows(T, X, Y, between="  "),
    "row of units": "t,x,y\ns,m,m\n" + rows(T, X, Y),
    "two units": "t [s],x [m],y [cm]\n" + rows(T, X, 100 * Y),
    "clock": "time,x,y\n" + "".join(
        f"2024-05-01 12:00:{t:06.3f},{x:.9g},{y:.9g}\n" for t, x, y in zip(T, X, Y, strict=True)
    ),
    "a row twice": "t,x,y\n" + rows(*(np.insert(c, 7, c[7]) for c in (T, X, Y))),
    "a quoted line": '"mass A"\n"t\tx\ty"\n"'
    + rows(T, X, Y, between="\t").replace("\n", '"\n"')[:-1],
    "a matrix": "t   x   y\n\n[" + rows(T, X, Y, between="  ").replace("\n", ";\n") + "]\n",
    "one run": '"Time (s) Run #3","X (m) Run #3","Y (m) Run #3"\n' + rows(T, X, Y),
    "a last word": "t,x,y\n" + rows(T, X, Y) + "end of measurement\n",
}  # fmt: skip


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_every_dialect_is_the_same_motion(tmp_path, text):
    found = read(tmp_path, text)
    np.testing.assert_allclose(found.positions[0, :, 0], np.stack([X, Y], -1), atol=1e-7)
    np.testing.assert_allclose(found.times[0] - found.times[0, 0], T, atol=1e-7)
    assert len(found.notes) == 1 and found.unit == "world"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "latin-1"])
def test_every_encoding_is_read(tmp_path, encoding):
    text = "Zeit/s;Höhe;x/µm;y/µm\n" + rows(T, 0 * T, X, Y, between=";", comma=True)
    found = read(tmp_path, text, encoding=encoding)
    np.testing.assert_allclose(found.positions[0, :, 0, 1], Y, atol=1e-7)
    assert found.length == "µm"


def test_a_text_is_told_from_prose(tmp_path):
    (tmp_path / "README.txt").write_text("Recorded in May, 3 trials.\nSee t.csv, 25 fps.\n")
    with pytest.raises(InputError, match="not a table that is known"):
        read_recording(tmp_path / "README.txt")
    found = read(tmp_path, rows(T, X, Y, between=" "), "t.txt")
    assert found.positions.shape == (1, 40, 1, 2)


# bodies


def test_bodies_are_told_by_labels_words_and_blocks(tmp_path):
    both = np.stack([np.stack([X, Y], -1), np.stack([Y, -X], -1)], 1)
    columns = (T, X, Y, Y, -X)
    for text in (
        "t,x1,y1,x2,y2\n" + rows(*columns),
        "t,ball_x,ball_y,hand_x,hand_y\n" + rows(*columns),
        "#multi:\n\tcm A\t\tcm B\t\nt\tx\ty\tx\ty\n" + rows(*columns, between="\t"),
        "t,x,y,x,y\n" + rows(*columns),
        rows(*columns, between=" "),
        "A\nt,x,y\n" + rows(T, X, Y) + "B\nt,x,y\n" + rows(T, Y, -X),
    ):
        np.testing.assert_allclose(read(tmp_path, text).positions[0], both, atol=1e-7)


def test_columns_before_and_after_the_named_ones(tmp_path):
    trial = np.repeat([0, 1], 20)
    for between in " \t":  # between the names there are blanks
        table = "% o1 w1\n" + rows(trial, T, X, VX, Y, Y, between=between)
        found = read(tmp_path, table, "m.txt")
        assert found.positions.shape == (2, 20, 1, 1) and found.unit == "angles"
        assert "2 columns after them left out" in found.notes[0]
    with pytest.raises(InputError, match="4 columns, but 2 names: a, b"):
        read(tmp_path, "a,b\n" + rows(X, Y, X, Y))


def test_runs_side_by_side_are_clips(tmp_path):
    short, late = slice(0, 30), T + 0.01
    cells = [[f"{v:.9g}" for v in column] for column in (T, X, late[short], Y[short])]
    cells = [column + [""] * (40 - len(column)) for column in cells]
    body = "".join(";".join(row) + "\n" for row in zip(*cells, strict=True))
    for names in (
        '"Time (s) Run #1";"Position (m) Run #1";"Time (s) Run #2";"Position (m) Run #2"\n',
        "Run 1: Time (s);Run 1: Position (m);Latest: Time (s);Latest: Position (m)\n",
    ):
        found = read(tmp_path, names + body)
        assert found.positions.shape == (2, 40, 1, 1) and found.length == "m"
        np.testing.assert_allclose(found.positions[0, :, 0, 0], X, atol=1e-7)
        np.testing.assert_allclose(found.positions[1, short, 0, 0], Y[short], atol=1e-7)
        assert np.isnan(found.positions[1, 30:]).all()
        np.testing.assert_allclose(found.times[1, short], late[short], atol=1e-7)
        assert "2 runs side by side" in found.notes[0]


def test_a_body_without_a_number_is_left_out(tmp_path):
    text = "t,x1,y1,x2,y2\n" + rows(T, X, Y).replace("\n", ",,\n")
    found = read(tmp_path, text)
    assert found.positions.shape == (1, 40, 1, 2)
    assert "x2/y2 left out: no row has a number" in found.notes[0]


def test_sensors_at_rest_and_constant_inputs_are_left_out(tmp_path):
    rest = 0.017 * (T > 0.5)
    text = "Time (s),Angle 1 (rad),Angle 2 (rad),Voltage (V)\n" + rows(T, X, rest, 0 * T)
    found = read(tmp_path, text)
    assert found.positions.shape == (1, 40, 1, 1) and found.inputs is None
    assert "Angle 2 (rad) left out: at rest" in found.notes[0]
    assert "Voltage (V) left out: without a change" in found.notes[0]
    assert read(tmp_path, "t,x1,y1,x2,y2\n" + rows(T, X, Y, rest, rest)).positions.shape[2] == 2


def test_rows_of_a_time_alone_are_left_out(tmp_path):
    lines = rows(T, X, Y, between="\t").splitlines()
    text = "t\tx\ty\n" + "".join(
        (line if k % 5 == 0 else line.split("\t")[0]) + "\n" for k, line in enumerate(lines)
    )
    found = read(tmp_path, text)
    np.testing.assert_allclose(found.times[0], T[::5], atol=1e-7)
    assert "32 incomplete rows left out" in found.notes[0]


# what is a place and what is not


def test_rates_inputs_and_degrees(tmp_path):
    text = "time,position,velocity,torque\n" + rows(T, X, VX, Y)
    found = read(tmp_path, text)
    assert found.unit == "angles" and found.positions.shape[2:] == (1, 1)
    assert "rates, not taken: velocity; known inputs: torque" in found.notes[0]
    degrees = read(tmp_path, "t [s];Winkel [°]\n" + rows(T, 90 * X, between=";"))
    np.testing.assert_allclose(degrees.positions[0, :, 0, 0], np.pi / 2 * X, atol=1e-7)
    assert (degrees.unit, degrees.length) == ("angles", "rad")


def test_a_rate_without_a_name_is_told_by_its_integral(tmp_path):
    found = read(tmp_path, rows(T, X, VX, between=" "))
    np.testing.assert_allclose(found.positions[0, :, 0], X[:, None], atol=1e-7)
    found = read(tmp_path, "a,b,c\n" + rows(T, X, VX))
    np.testing.assert_allclose(found.positions[0, :, 0], X[:, None], atol=1e-7)


def test_pixels_and_lengths_are_said(tmp_path):
    found = read(tmp_path, "frame,x_px,y_px\n" + rows(np.arange(40), X, Y), interval=0.04)
    assert (found.unit, found.length) == ("pixels", "px")
    np.testing.assert_allclose(found.times[0], T)
    assert read(tmp_path, "t,x (cm)\n" + rows(T, X)).length == "cm"
    assert read(tmp_path, "t,x\n" + rows(T, X)).length == ""


def test_a_coordinate_alone_is_an_angle_in_a_file_called_after_a_pendulum(tmp_path):
    text = "t,position\n" + rows(T, X)
    assert read(tmp_path, text, "Pendulum2.csv").unit == "angles"
    assert read(tmp_path, text, "cart.csv").unit == "world"


@pytest.mark.parametrize(
    "name, kind, axis, body, unit",
    [
        ("x_ball", "place", "x", "ball", ""),
        ("X Position (cm)", "place", "x", "", "cm"),
        ("θ₁", "place", "angle", "1", ""),
        ("v_{x}", "rate", "", "", ""),
        ("θ̇", "rate", "", "", ""),
        ("x (m/s)", "rate", "", "", "m/s"),
        ("x_error", "", "", "", ""),
        ("t [ms]", "time", "", "", "ms"),
        ("τ", "input", "", "", ""),
        ("Output Voltage (V)", "input", "", "", "V"),
        ("Commanded Pos", "input", "", "", ""),
        ("Tid (s)", "time", "", "", "s"),
        ("hauteur (m)", "place", "q", "", "m"),
        ("Length (cm)", "measure", "", "", "cm"),
    ],
)
def test_names_say_what_a_column_is(name, kind, axis, body, unit):
    found = meaning_of(name)
    assert (found.kind, found.axis, found.body, found.unit) == (kind, axis, body, unit)


# times


def test_times_that_begin_anew_are_trials_and_uneven_ones_stay(tmp_path):
    found = read(tmp_path, "t,x\n" + rows(np.tile(T, 3), np.tile(X, 3)))
    assert found.positions.shape == (3, 40, 1, 1) and "begin anew, so 3 clips" in found.notes[0]
    uneven = T + 0.01 * np.sin(17 * T)
    found = read(tmp_path, "t,x\n" + rows(np.delete(uneven, 9), np.delete(X, 9)))
    np.testing.assert_allclose(found.times[0], np.delete(uneven, 9), atol=1e-7)


def test_a_coarse_clock_is_spread_and_missing_cells_are_gaps(tmp_path):
    found = read(tmp_path, "t,x\n" + rows(np.floor(T * 10) / 10, X, digits=6))
    assert np.diff(found.times[0]).min() > 0.03 and "coarser" in found.notes[0]
    text = "t,x\n" + rows(T, X).replace(f"{X[4]:.9g}\n", "NaN\n").replace(f"{X[6]:.9g}\n", "\n")
    seen = np.isfinite(read(tmp_path, text).positions[0, :, 0, 0])
    assert list(np.flatnonzero(~seen)) == [4, 6]


@pytest.mark.parametrize(
    "text, said",
    [
        ("t,x,y,z,w\n" + rows(T, X, Y), "3 numbers in a row, but 5 names"),
        ("nothing here\n", "no rows of numbers"),
        ("t,a,b\n" + rows(T, X, Y), "no coordinates among the columns t, a, b"),
        ("length,time\n" + rows(X, T), "length: the measure of a thing is no place"),
        ("t,ax,ay\n" + rows(T, X, Y), "ax, ay: a law is found from places or angles, which no acc"),
        (b"\x00\x01\x02\x03" * 40, "not a text of numbers"),
    ],
)
def test_what_cannot_be_read_ends_in_one_line(tmp_path, text, said):
    with pytest.raises(InputError, match=said) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_what_programs_export_is_told(tmp_path):
    frames = np.arange(40)
    spots = "LABEL,TRACK_ID,POSITION_X,POSITION_Y,POSITION_T\nLabel,Track ID,X,Y,T\n"
    spots += ",,(pixel),(pixel),(sec)\n" + rows(frames, 0 * T, X, Y, T)
    found = read(tmp_path, spots)  # TrackMate's
    assert (found.unit, found.positions.shape) == ("pixels", (1, 40, 1, 2))
    logger = "Vernier Format 2\nRun 1\nTime\tPosition\tVelocity\nt\tx\tv\ns\tm\tm/s\n\n"
    found = read(tmp_path, logger + rows(T, X, VX, between="\t"))
    np.testing.assert_allclose(found.positions[0, :, 0], X[:, None], atol=1e-7)
    assert found.length == "m"
    slices = ",Label,Area,X,Y,Slice\n"
    slices += "".join(f"{k + 1},img{k},9,{X[k]},{Y[k]},{k + 1}\n" for k in frames)
    assert read(tmp_path, slices, interval=0.04).positions.shape == (1, 40, 1, 2)  # ImageJ's
    marks = " ,Track n°,Slice n°,X,Y,Distance,Velocity,Pixel Value\n"
    marks += "".join(f"{k + 1},1,{k + 1},{X[k]},{Y[k]},2.5,60,255\n" for k in frames)
    marked = read(tmp_path, marks, interval=0.04)  # Manual Tracking's
    assert marked.positions.shape == (1, 40, 1, 2)
    assert np.diff(marked.times[0]) == pytest.approx(0.04)


def test_a_name_that_says_time_in_another_language_numbers_tracks(tmp_path):
    """MTrackJ's TID, beside a time that rises."""
    text = "Nr,TID,PID,x [pixel],y [pixel],t [sec],I [val]\n"
    for n in (1, 2):
        text += "".join(f"{n},{n},{k + 1},{X[k] + n},{Y[k]},{k / 25:.3f},9\n" for k in range(40))
    found = read(tmp_path, text)
    assert found.positions.shape == (1, 40, 2, 2) and found.unit == "pixels"
    assert np.diff(found.times[0]) == pytest.approx(0.04)


def test_a_third_axis_along_which_nothing_moves_is_left_out(tmp_path):
    """As of programs that write z for flat pictures as well."""
    text = "\n".join(["t,x,y,z", *(f"{k / 25},{X[k]},{X[k] ** 2},0.0" for k in range(40))])
    found = read(tmp_path, text)
    assert found.positions.shape == (1, 40, 1, 2)
    assert any("z left out: without a change" in note for note in found.notes)
    deep = text.replace(",0.0", ",0.5", 1)
    assert read(tmp_path, deep).positions.shape == (1, 40, 1, 3)


def test_columns_override_names_and_say_units(tmp_path):
    text = "when,a,b\n" + rows(1000 * T, X, Y)
    found = read(tmp_path, text, columns={"time[ms]": "when", "x": "a", "y": "b"})
    np.testing.assert_allclose(found.times[0], T, atol=1e-7)
    with pytest.raises(InputError, match="`columns` plce=a: no such role"):
        read(tmp_path, text, columns={"plce": "a"})


# projects of Tracker


def project(frames, places, angle=0.0, scale=100.0, length="m"):
    def prop(name, value):
        return f'<property name="{name}" type="double">{value}</property>'

    def held(kind, inside):
        return f'<object class="org.opensourcephysics.{kind}">{inside}</object>'

    def marks(number, at):
        each = held("cabrillo.tracker.PointMass$FrameData", prop("x", at[0]) + prop("y", at[1]))
        return f'<property name="[{number}]" type="object">{each}</property>'

    axes = prop("xorigin", 50) + prop("yorigin", 200) + prop("angle", angle)
    axes += prop("xscale", scale) + prop("yscale", scale)
    axes = held("media.core.ImageCoordSystem$FrameData", axes)
    coords = f'<property name="framedata"><property name="[0]">{axes}</property></property>'
    tracks = ""
    for name, path in places.items():
        data = "".join(marks(k, at) for k, at in zip(frames, path, strict=True))
        inside = (
            f'<property name="name">{name}</property><property name="framedata">{data}</property>'
        )
        tracks += f'<property name="item">{held("cabrillo.tracker.PointMass", inside)}</property>'
    clip = held("media.core.VideoClip", prop("startframe", 4) + prop("starttime", 200))
    control = held("media.core.StepperClipControl", prop("delta_t", 40))
    return '<?xml version="1.0"?>' + held(
        "cabrillo.tracker.TrackerPanel",
        f'<property name="videoclip">{clip}</property>'
        f'<property name="clipcontrol">{control}</property>'
        f'<property name="coords">{held("media.core.ImageCoordSystem", coords)}</property>'
        f'<property name="length_unit">{length}</property>'
        f'<property name="tracks">{tracks}</property>',
    )


def picture(x, y, angle):
    """Pixels of a place in axes that are turned."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([50 + 100 * (c * x - s * y), 200 - 100 * (s * x + c * y)], -1)


def test_tracks_are_read_in_the_author_s_axes(tmp_path):
    frames = np.arange(4, 44)
    places = {"ball": picture(X, Y, 0.3), "hand": picture(Y, X, 0.3)}
    text = project(
        np.delete(frames, 6), {k: np.delete(v, 6, 0) for k, v in places.items()}, np.degrees(0.3)
    )
    found = read(tmp_path, text, "a.trk")
    assert found.length == "m" and found.unit == "world" and found.positions.shape == (1, 40, 2, 2)
    assert np.isnan(found.positions[0, 6]).all()
    kept = np.arange(40) != 6
    np.testing.assert_allclose(found.positions[0, kept, 0], np.stack([X, Y], -1)[kept], atol=1e-9)
    np.testing.assert_allclose(found.times[0], 0.2 + T, atol=1e-9)
    with zipfile.ZipFile(tmp_path / "a.trz", "w") as archive:
        archive.writestr("inside/a.trk", text)
    again = read_recording(tmp_path / "a.trz", {"body": "hand"})
    np.testing.assert_array_equal(again.positions[:, :, 0], found.positions[:, :, 1])


def test_a_project_without_a_scale_is_in_pixels(tmp_path):
    found = read(tmp_path, project(range(40), {"a": picture(X, Y, 0)}, scale=1.0), "a.trk")
    assert found.length == "px"
    np.testing.assert_allclose(found.positions[0, :, 0, 1], 100 * Y, atol=1e-9)


# MATLAB's files


def test_vectors_are_found_however_deep(tmp_path):
    inside = {"params": {"m": 0.1}, "rec": {"time": T, "theta": X, "dtheta": VX, "tau": Y}}
    savemat(tmp_path / "a.mat", {"data": inside, "dt": 0.04})
    found = read_recording(tmp_path / "a.mat")
    assert found.unit == "angles"
    np.testing.assert_allclose(found.positions[0, :, 0, 0], X)
    np.testing.assert_allclose(found.times[0], T)


def test_a_state_in_pieces_is_one_recording_without_its_rates(tmp_path):
    pieces = np.empty(2, object), np.empty(2, object)
    for k, part in enumerate((slice(0, 20), slice(20, 40))):
        pieces[0][k], pieces[1][k] = T[part], np.stack([X[part], VX[part]])
    savemat(tmp_path / "a.mat", {"Time": pieces[0], "Y": pieces[1]})
    found = read_recording(tmp_path / "a.mat")
    np.testing.assert_allclose(found.positions[0, :, 0], X[:, None])
    np.testing.assert_allclose(found.times[0], T)
    savemat(tmp_path / "b.mat", {"x": X, "fps": 25.0})
    np.testing.assert_allclose(read_recording(tmp_path / "b.mat").times[0], T)


def newest(path, fill):
    """A file in the layout of MATLAB 7.3: HDF5 behind a header, arrays turned over."""
    with h5py.File(path, "w", userblock_size=512) as out:
        fill(out)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


def put(group, name, values, kind=b"double"):
    group[name] = np.atleast_2d(values).T
    group[name].attrs["MATLAB_class"] = np.bytes_(kind)
    return group[name]


def cells(group, name, pieces):
    held = group.file.require_group("#refs#")
    refs = [put(held, f"{name}{k}", piece).ref for k, piece in enumerate(pieces)]
    group.create_dataset(name, data=np.array([refs], h5py.ref_dtype))
    group[name].attrs["MATLAB_class"] = np.bytes_(b"cell")


def test_a_file_of_version_7_3_is_read_as_an_older_one(tmp_path):
    def fill(out):
        record = out.create_group("data/rec")
        put(record, "time", T)
        put(record, "theta", X)
        put(record, "name", np.arange(40, dtype=np.uint16), b"char")
        put(out, "none", np.zeros(2, np.uint64)).attrs["MATLAB_empty"] = 1

    found = read_recording(newest(tmp_path / "a.mat", fill))
    assert found.unit == "angles"
    np.testing.assert_array_equal(found.positions[0, :, 0, 0], X)
    np.testing.assert_array_equal(found.times[0], T)

    def pieces(out):
        parts = slice(0, 20), slice(20, 40)
        cells(out, "Time", [T[part] for part in parts])
        cells(out, "Y", [np.stack([X[part], VX[part]]) for part in parts])

    found = read_recording(newest(tmp_path / "b.mat", pieces))
    np.testing.assert_array_equal(found.positions[0, :, 0], X[:, None])


def test_a_file_of_version_7_3_leads_nowhere_and_fills_nothing(tmp_path):
    newest(tmp_path / "secret.mat", lambda out: (put(out, "t", T), put(out, "x", X)))

    def linked(out):
        for name in "tx":
            out[name] = h5py.ExternalLink(str(tmp_path / "secret.mat"), name)

    with pytest.raises(InputError, match="no vectors of 8 numbers"):
        read_recording(newest(tmp_path / "a.mat", linked))

    def around(out):
        group = out.create_group("a")
        group["b"] = group  # a group that holds itself

    with pytest.raises(InputError, match="structures in more than 20 levels"):
        read_recording(newest(tmp_path / "b.mat", around))

    def again(out):
        held = put(out.create_group("#refs#"), "x", np.zeros(2**20))
        out.create_dataset("c", data=np.array([[held.ref] * 2000], h5py.ref_dtype))

    with pytest.raises(InputError, match="more than"):
        read_recording(newest(tmp_path / "c.mat", again))


# workbooks


def book(path, *sheets):
    """A workbook of these sheets, rows each."""
    made = openpyxl.Workbook()
    made.remove(made.active)
    for name, rows in sheets:
        sheet = made.create_sheet(name)
        for row in rows:
            sheet.append(row)
    made.save(path)


def test_a_workbooks_sheet_of_numbers_is_read_as_a_text_would_be(tmp_path):
    numbers = np.column_stack([T, X, Y]).tolist()
    numbers[7][2] = None
    about = ["device", "phone"], ["version", 1.2]
    named = ["Time (s)", "Position x (cm)", "Position y (cm)"]
    book(tmp_path / "a.xlsx", ("About", about), ("Raw Data", [["a ball"], named, *numbers]))
    found = read_recording(tmp_path / "a.xlsx")
    assert found.length == "cm" and found.unit == "world"
    np.testing.assert_allclose(found.times[0], T)
    np.testing.assert_allclose(found.positions[0, :, 0, 0], X)
    seen = np.delete(np.arange(len(Y)), 7)
    np.testing.assert_allclose(found.positions[0, seen, 0, 1], Y[seen])
    assert np.isnan(found.positions[0, 7, 0, 1])
    assert list(read_table(tmp_path / "a.xlsx")) == named


def test_decimal_commas_in_a_workbooks_words(tmp_path):
    words = [line.split() for line in rows(T, X, between=" ", comma=True).splitlines()]
    book(tmp_path / "a.xlsx", ("1", [["t", "x"], *words]))
    np.testing.assert_allclose(read_recording(tmp_path / "a.xlsx").positions.ravel(), X, atol=1e-7)


def test_workbooks_without_their_reader_say_what_to_install(tmp_path, monkeypatch):
    book(tmp_path / "a.xlsx", ("1", [["t", "x"], [0, 1], [1, 2]]))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"vidphys\[excel\]"):
        read_recording(tmp_path / "a.xlsx")


# real recordings


@real
@pytest.mark.parametrize(
    "name, shape, unit",
    [
        ("double_pendulum_mocap.txt", (2, 819, 2, 1), "rad"),
        ("pendulum_circle_mocap.txt", (1, 600, 1, 2), ""),
        ("pendulum_torque.csv", (1, 1170, 1, 1), "rad"),
        ("pendulum_encoder.mat", (1, 55001, 1, 1), "rad"),
        ("tracker_diabolo.trk", (1, 174, 2, 2), "m"),
        ("two_masses_mocap.txt", (1, 495, 2, 1), ""),
    ],
)
def test_real_tables_are_read_as_they_are(name, shape, unit):
    found = read_recording(Path(REAL or "") / name)
    assert found.positions.shape == shape and found.length == unit


@real
def test_real_projects_fall_as_their_authors_tracks_do():
    toss = read_recording(Path(REAL or "") / "tracker_ball_toss.trz")
    fitted = 2 * np.polyfit(toss.times[0], toss.positions[0, :, 0], 2)[0]
    np.testing.assert_allclose(fitted, [0.20, -10.27], atol=0.01)
    cups = read_recording(Path(REAL or "") / "tracker_cups.zip")
    assert cups.positions.shape == (1, 9, 2, 2) and cups.length == "m"
