"""Texts as laboratories and observatories export them, in dialects that no standard has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vidphys.data.formats import FORMATS, Recording, TrackFormat, read_recording
from vidphys.data.formats.names import meaning_of
from vidphys.data.formats.wrapped import semicolons
from vidphys.errors import InputError

ROWS = 12
T = np.arange(ROWS) * 0.01
A = np.stack([-15.6 + 58 * T, 5.6 - 3 * T], 1)
B = np.stack([1.95 - 2.4 * T, 3.2 + 0 * T], 1)
MINUS = "\N{MINUS SIGN}"


def read(folder: Path, text: str, name: str, interval: float | None = None) -> Recording:
    path = folder / name
    path.write_text(text)
    return read_recording(path, interval=interval)


def test_commas_between_numbers_and_within_are_told_apart(tmp_path) -> None:
    rows = [",".join(f"{x:.6E}".replace(".", ",") for x in row) for row in np.c_[T, A, B]]
    rows[3] = ",".join(rows[3].split(",")[:6]) + ",,"  # where the second mass was not marked
    text = "#multi:\n,mass A,,mass B,,\nt,x,y,x,y,\n" + "\n".join(rows) + "\n"
    found = read(tmp_path, text.replace("-", MINUS), "collision.txt")
    np.testing.assert_allclose(found.times[0], T, atol=1e-7)
    np.testing.assert_allclose(found.positions[0, :, 0], A, rtol=1e-6)
    assert np.isnan(found.positions[0, 3, 1]).all()
    np.testing.assert_allclose(np.delete(found.positions[0, :, 1], 3, 0), np.delete(B, 3, 0))


@pytest.mark.parametrize(
    "lines", [["t,x", "0,1", "1,2"], ["t,x", "0,0,1", "1,2,3"], ["0,1,2,3"], ["t,x", "0,0,1,x"]]
)
def test_commas_that_may_stand_between_numbers_alone_stay(lines) -> None:
    assert semicolons(lines) == lines


def test_qualisys_may_say_its_version_first_and_kinds_of_tracks_last(tmp_path) -> None:
    head = ["FILE_VERSION\t2.0.0", f"NO_OF_FRAMES\t{ROWS}", "NO_OF_MARKERS\t2", "FREQUENCY\t500"]
    head += ["MARKER_NAMES\tone\ttwo", "TRAJECTORY_TYPES\tMeasured\tMeasured"]
    rows = ["\t".join(f"{x:.3f}" for x in (*a, 9.0, *b, 9.0)) for a, b in zip(A, B, strict=True)]
    found = read(tmp_path, "\r\n".join(head + rows) + "\r\n", "A1.tsv")
    np.testing.assert_allclose(found.positions[0, :, 0, :2], A, atol=1e-3)
    np.testing.assert_allclose(found.times[0], np.arange(ROWS) / 500)


@pytest.mark.parametrize("rate", [23.976, 29.97, 59.94, 240.0])
def test_times_that_step_as_frames_of_a_film_do_are_milliseconds(tmp_path, rate) -> None:
    times = 633.967 + 1e3 * np.arange(ROWS) / rate
    text = "frame,time,x,y\n" + "".join(f"{k},{t:.6f},1,{k}\n" for k, t in enumerate(times))
    found = read(tmp_path, text, "drop.csv")
    np.testing.assert_allclose(np.diff(found.times[0]), 1 / rate, rtol=1e-4)
    assert f"taken for ms: its steps are those of {rate:g} frames a second" in found.notes[0]
    late = text.replace(f"{times[1]:.6f}", f"{times[1] + 9:.6f}")
    assert np.diff(read(tmp_path, late, "drop.csv").times[0]).max() < 0.1


def test_times_in_seconds_stay_seconds(tmp_path) -> None:
    text = "time,x\n" + "".join(f"{0.5 + 16.5 * k},{k % 3}\n" for k in range(ROWS))
    np.testing.assert_allclose(np.diff(read(tmp_path, text, "slow.csv").times[0]), 16.5)


@pytest.mark.parametrize("word", ["Aceleracion_X", "Aceleración_X", "Velocità_X", "Accélération_X"])
def test_words_may_lack_their_accents_and_units_have_blanks(word) -> None:
    assert meaning_of(word).kind == "rate"
    assert meaning_of("Time ( s )").kind == "time" and meaning_of("x ( cm )").unit == "cm"
    assert meaning_of("Höhe").axis == meaning_of("Hohe").axis == "q"


def test_a_body_that_is_another_one_again_is_left_out(tmp_path) -> None:
    places = np.c_[T, A, B, A]
    names = "t,x1,y1,x2,y2,x3,y3\n"
    rows = "".join(",".join(f"{x:.6f}" for x in row) + "\n" for row in places)
    found = read(tmp_path, names + rows, "twice.csv")
    np.testing.assert_allclose(found.positions[0], np.stack([A, B], 1), atol=1e-6)
    assert "x3/y3 left out: always where another one is" in found.notes[0]


def test_atoms_of_a_wrong_number_are_refused_in_one_line(tmp_path) -> None:
    frame = "4\nwater\nO 0 0 0.{0}\nH 0 0 1.{0}\nH 0 1 0.{0}\n"
    with pytest.raises(InputError, match=r"not numbers \('O'\)"):
        read(tmp_path, "".join(frame.format(k) for k in range(9)), "water.xyz")


def test_a_text_of_numbers_may_be_called_anything(tmp_path) -> None:
    above = "% tennis\n%\n%   valLower: 141\n%   valUpper: 256\n"
    text = above + "".join(f"{t:.2f}, {x:.3f}, {y:.3f}\n" for t, (x, y) in zip(T, A, strict=True))
    found = read(tmp_path, text, "ball.dlm")
    np.testing.assert_allclose(found.positions[0, :, 0], A, atol=1e-3)
    np.testing.assert_allclose(found.times[0], T)


def test_a_format_of_another_package_comes_before_a_text_of_any_name(tmp_path, monkeypatch) -> None:
    (tmp_path / "run.own").write_text("0,1\n1,2\n2,3\n")
    own = TrackFormat((".own",), lambda *_: Recording(np.ones((1, 9, 1, 2)), None))
    monkeypatch.setitem(FORMATS._parts, "own", own)
    monkeypatch.setitem(FORMATS._modules, "own", "other.formats")
    assert read_recording(tmp_path / "run.own").positions.shape == (1, 9, 1, 2)


def test_an_ephemeris_of_horizons_is_its_rows(tmp_path) -> None:
    names = "  JDTDB,   Calendar Date (TDB),   X,   Y,   Z,   VX,   VY,   VZ,"
    rows = [
        f"{2460554.5 + k:.6f}, A.D. 2024-Sep-{k + 1:02d} 00:00:00.0000, {x:.9E}, {y:.9E}, "
        f"{0.1 * x:.9E}, 0.0, 0.0, 0.0,"
        for k, (x, y) in enumerate(A)
    ]
    stars = "*" * 40
    lines = [stars, "Output units    : AU-D", stars, names, stars, "$$SOE", *rows, "$$EOE", stars]
    found = read(tmp_path, "\n".join([*lines, "TIME", "  Dynamical Time"]), "mars.txt")
    np.testing.assert_allclose(found.positions[0, :, 0, :2], A)
    np.testing.assert_allclose(np.diff(found.times[0]), 86400.0)
