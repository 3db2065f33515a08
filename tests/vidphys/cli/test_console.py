"""What a verb shows while it works, where nobody sits at a terminal."""

from __future__ import annotations

import time

import pytest

from vidphys.cli import console as module
from vidphys.cli.console import Console


def waited(capsys: pytest.CaptureFixture[str], lines: int, seconds: float = 10.0) -> str:
    """What is said once there are so many lines of it, or the time is over."""
    told, began = "", time.monotonic()
    while told.count("\n") < lines and time.monotonic() - began < seconds:
        time.sleep(0.01)
        told += capsys.readouterr().err
    return told


def test_work_of_unknown_length_says_that_it_goes_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LINE_SECONDS", 0.02)
    with Console(quiet=False, units=1, name="verb") as console:
        with console.busy("the search"):
            told = waited(capsys, 2)
        capsys.readouterr()
        time.sleep(0.1)
    assert told.splitlines()[1].endswith("s] the search goes on")
    assert capsys.readouterr().err == ""  # nor after its end


def test_a_quiet_verb_says_nothing_while_it_works(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LINE_SECONDS", 0.01)
    with Console(quiet=True, units=1, name="verb") as console, console.busy("the search"):
        time.sleep(0.1)
    assert capsys.readouterr().err == ""
