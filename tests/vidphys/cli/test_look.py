"""``vidphys diagnose CLIP --look``: what may be a body, drawn and numbered."""

import re

import numpy as np
import pytest

from vidphys.cli import main
from vidphys.data.rendered import write_video

COUNT, HEIGHT, WIDTH = 24, 72, 96


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Two discs that cross the picture, a large one above a small one."""
    path = tmp_path_factory.mktemp("clip") / "two.avi"
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    frames = 40 + np.random.default_rng(0).integers(0, 3, (COUNT, HEIGHT, WIDTH, 3))
    for t, frame in enumerate(frames):
        frame[np.hypot(x - 10 - 3 * t, y - 20) < 8] = 240
        frame[np.hypot(x - 84 + 2.5 * t, y - 55) < 4] = 240
    write_video(path, frames.astype(np.uint8), 30.0)
    return path


def test_what_moves_is_drawn_and_told_by_number_place_and_frame(clip, tmp_path, capsys):
    assert main(["diagnose", str(clip), "--look", "--out", str(tmp_path / "o"), "--quiet"]) == 0
    *things, last = capsys.readouterr().out.splitlines()
    assert str(tmp_path / "o" / "look.png") in last and "--choose" in last
    assert (tmp_path / "o" / "look.png").read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "o" / "summary.txt").exists()
    rows = set()
    for number, thing in enumerate(things, 1):
        found = re.fullmatch(rf"{number}: (\d+) px wide, .* at (\d+),(\d+),(\d+)", thing)
        wide, column, row, frame = map(int, found.groups())
        middle = 10 + 3 * frame if row < 40 else 84 - 2.5 * frame
        assert abs(column - middle) <= 2 and wide == pytest.approx(16 if row < 40 else 8, abs=4)
        rows.add(row)
    assert rows == {20, 55}


def test_a_table_is_not_looked_at(tmp_path, capsys):
    assert main(["diagnose", "t.csv", "--look", "--out", str(tmp_path / "o")]) == 2
    assert "--look: would have no effect" in capsys.readouterr().err
