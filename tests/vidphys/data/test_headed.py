"""Texts with a heading above each frame or body, and columns that need a second look."""

from pathlib import Path

import numpy as np
import pytest

from vidphys.data.formats import read_recording
from vidphys.data.formats.base import Recording

T = np.arange(12) * 0.1
A = np.stack([0.1 + T, 1 + T - 4.9 * T**2], -1)
B = np.stack([2 * T, np.cos(T)], -1)


def read(folder: Path, text: str, name: str = "a.txt", interval: float | None = None) -> Recording:
    (folder / name).write_text(text)
    return read_recording(folder / name, interval=interval)


def rows(*columns: np.ndarray, mark: str = ",") -> str:
    return "".join(mark.join(f"{x:.5f}" for x in row) + "\n" for row in zip(*columns, strict=True))


def test_trajectories_of_kinovea_are_bodies(tmp_path) -> None:
    blocks = [f"# {who}\n" + rows(T, *q.T, mark=" ") for who, q in (("left foot", A), ("toe", B))]
    text = "#Kinovea Trajectory data export\n#T X Y\n\n" + "\n".join(blocks).replace(".", ",")
    found = read(tmp_path, text)
    np.testing.assert_allclose(found.positions[0], np.stack([A, B], 1), atol=1e-4)


def test_an_xyz_file_has_a_body_for_each_atom(tmp_path) -> None:
    each = zip(A, B, strict=True)
    frames = "".join(f"2\nargon\nAr {a[0]} {a[1]} 1\nNe {b[0]} {b[1]} 2\n" for a, b in each)
    found = read(tmp_path, frames, "two.xyz", 0.5)
    np.testing.assert_allclose(found.positions[0, ..., :2], np.stack([A, B], 1))
    np.testing.assert_allclose(found.times[0], 0.5 * np.arange(12))


def test_a_dump_of_lammps_is_read_by_its_names(tmp_path) -> None:
    head = "ITEM: TIMESTEP\n{}\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS pp pp\n0 1\n0 1\n"
    frames = [
        head.format(100 * k)
        + "ITEM: ATOMS id type xu yu zu\n"
        + f"2 1 {B[k, 0]} {B[k, 1]} 0.5\n1 1 {A[k, 0]} {A[k, 1]} 0.5\n"
        for k in range(12)
    ]
    found = read(tmp_path, "".join(frames), "dump.lammpstrj", 0.01)
    np.testing.assert_allclose(found.positions[0], np.stack([A, B], 1))


def test_names_and_units_may_stand_in_comments(tmp_path) -> None:
    head = "#Creator: lab\n#Time A\tPos A\n#[s]\t[cm]\n"
    found = read(tmp_path, head + rows(T, A[:, 1], mark="\t"))
    assert found.length == "cm"
    np.testing.assert_allclose(found.positions[0, :, 0, 0], A[:, 1], atol=1e-5)


@pytest.mark.parametrize("derived", ["der(x)", "dx/dt"])
def test_a_derivative_is_no_place(tmp_path, derived) -> None:
    text = f'"time","x","y","{derived}","der(y)"\n' + rows(T, *A.T, *B.T)
    np.testing.assert_allclose(read(tmp_path, text).positions[0, :, 0], A, atol=1e-4)


def test_rx_is_a_place_where_nothing_else_is_one_and_a_rotation_else(tmp_path) -> None:
    alone = read(tmp_path, "t,rx,ry,vx,vy\n" + rows(T, *A.T, *B.T))
    np.testing.assert_allclose(alone.positions[0, :, 0], A, atol=1e-4)
    beside = read(tmp_path, "t,rx,ry,tx,ty\n" + rows(T, *A.T, *B.T))
    np.testing.assert_allclose(beside.positions[0, :, 0], B, atol=1e-4)


def test_what_moves_is_taken_before_what_rests(tmp_path) -> None:
    found = read(tmp_path, "t,X,Theta\n" + rows(T, np.zeros(12), A[:, 1]))
    assert found.unit == "angles"
    np.testing.assert_allclose(found.positions[0, :, 0, 0], A[:, 1], atol=1e-5)


def test_spots_of_trackmate_are_told_apart_by_their_track(tmp_path) -> None:
    spots = "".join(
        f"ID{2 * k + j},{2 * k + j},{j},{q[k, 0]:.5f},{q[k, 1]:.5f},{k}\n"
        for k in range(12)
        for j, q in enumerate((A, B))
    )
    found = read(tmp_path, "Label,ID,TRACK_ID,POSITION_X,POSITION_Y,FRAME\n" + spots, interval=0.1)
    np.testing.assert_allclose(found.positions[0], np.stack([A, B], 1), atol=1e-4)


def test_rows_of_bodies_without_times_follow_each_other(tmp_path) -> None:
    pairs = zip(A, B, strict=True)
    text = "name;position x;position y\n" + "".join(
        f"sun;{a[0]:.5f};{a[1]:.5f}\nearth;{b[0]:.5f};{b[1]:.5f}\n" for a, b in pairs
    )
    found = read(tmp_path, text, interval=2.0)
    np.testing.assert_allclose(found.positions[0], np.stack([B, A], 1), atol=1e-4)
    np.testing.assert_allclose(np.diff(found.times[0]), 2.0)


def test_dates_are_told_since_the_first(tmp_path) -> None:
    found = read(tmp_path, "jd,x,y\n" + rows(2459000.5 + T, *A.T))
    np.testing.assert_allclose(found.times[0], 86400 * T, atol=2.0)
