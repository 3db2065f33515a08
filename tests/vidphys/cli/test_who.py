"""Which bodies are followed: options that diagnose and train share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vidphys.cli import main
from vidphys.cli.options import make_binder
from vidphys.cli.who import WhoOptions


def test_what_is_said_reaches_the_binder(tmp_path):
    import cv2

    mask = np.zeros((4, 6), np.uint8)
    mask[:, 3:] = 255
    cv2.imwrite(str(tmp_path / "m.png"), mask)
    who = WhoOptions(at=("3,4.5,7",), region="0,1,20,30", colour="#ff8000", mask=tmp_path / "m.png")
    binder = make_binder(None, None, None, who)
    assert binder.bodies is None and binder.wanted.at == ((3.0, 4.5, 7),)
    assert binder.wanted.region == (0.0, 1.0, 20.0, 30.0)
    assert binder.wanted.colour == (255, 128, 0)
    np.testing.assert_array_equal(binder.wanted.mask, mask > 0)
    assert make_binder(None, None, None, WhoOptions(size=9.0)).bodies == 1


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--at", "3,4"], "--at 3,4: write X,Y,FRAME"),
        (["--region", "a,b,c,d"], "--region a,b,c,d: write X,Y,WIDTH,HEIGHT"),
        (["--colour", "rde"], "--colour rde: write a name such as red"),
        (["--size", "0"], "--size 0.0: must be above 0"),
        (["--mask", "nowhere.png"], "--mask nowhere.png: no picture"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, capsys, arguments, said):
    assert main(["diagnose", "nowhere.mp4", *arguments, "--out", str(tmp_path / "o")]) == 2
    assert said in capsys.readouterr().err


def test_it_is_refused_for_a_table(tmp_path, capsys):
    assert main(["diagnose", "t.csv", "--colour", "red", "--out", str(Path(tmp_path) / "o")]) == 2
    assert "--colour: would have no effect" in capsys.readouterr().err
