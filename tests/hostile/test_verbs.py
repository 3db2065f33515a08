"""F4, F10 and what strangers give: one line and a code, no traceback, no hang, no crash."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vidphys import cli
from vidphys.cli import diagnose as verb
from vidphys.cli import falls, main
from vidphys.cli.console import Console
from vidphys.data.formats.opencv import read_clip
from vidphys.errors import InputError

TIMES = 0.1 * np.arange(40)
FALLING = np.stack([1 + 3 * TIMES, 2 - 2 * TIMES - 5 * TIMES**2], -1)


def table(path: Path, times: np.ndarray = TIMES, positions: np.ndarray = FALLING) -> Path:
    np.savez(path, times=times, q=positions[None, :, None])
    return path


def with_last(value: float) -> np.ndarray:
    return np.append(TIMES[:-1], value)


@pytest.mark.parametrize(
    ("times", "positions", "said"),
    [
        (with_last(np.inf), FALLING, "times must be finite numbers"),
        (with_last(np.nan), FALLING, "times must be finite numbers"),
        (with_last(1e300), FALLING, "between two frames lie 1e+300 s"),
        (with_last(9e5), FALLING, "between two frames lie 9e+05 s"),
        (TIMES, 1e200 * FALLING, "positions beyond 1e+100"),
    ],
)
def test_times_and_places_that_no_recording_has(tmp_path, capsys, times, positions, said):
    path = table(tmp_path / "a.npz", times, positions)
    assert main(["diagnose", str(path), "--out", str(tmp_path / "run")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("option", ["--gravity", "--hold-out", "--rate", "--shadow"])
@pytest.mark.parametrize("value", ["inf", "nan"])
def test_an_option_that_is_no_number_is_refused_by_name(tmp_path, capsys, option, value):
    path = table(tmp_path / "a.npz")
    assert main(["diagnose", str(path), option, value, "--out", str(tmp_path / "run")]) == 2
    assert f"{option} {value}: must be a finite number" in capsys.readouterr().err


def test_a_clip_whose_name_is_not_utf8_is_refused_and_decoded_by_nobody(tmp_path, capsys):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.mp4"))
    path.write_bytes(b"x")
    assert main(["diagnose", str(path), "--out", str(tmp_path / "run")]) == 2
    assert "the name is not UTF-8; rename it" in capsys.readouterr().err
    with pytest.raises(InputError, match="the name is not UTF-8"):
        read_clip(path)


@pytest.mark.parametrize("verb", ["ladder", "extract"])
def test_a_url_where_a_folder_is_needed_is_refused_and_no_folder_of_its_name_made(
    tmp_path, capsys, monkeypatch, verb
):
    monkeypatch.chdir(tmp_path)
    assert main([verb, *(["."] if verb == "extract" else []), "--out", "s3://bucket/run"]) == 2
    assert "--out s3://bucket/run: a URL" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.mp4", "a.trk", "a.mat"])
def test_a_pipe_is_no_file(tmp_path, capsys, name):
    os.mkfifo(tmp_path / name)
    assert main(["diagnose", str(tmp_path / name), "--out", str(tmp_path / "run")]) == 2
    assert "no such file" in capsys.readouterr().err
    assert main(["train", str(tmp_path / name), "--out", str(tmp_path / "run")]) == 2


@pytest.mark.parametrize("out", ["file", "file/below"])
def test_f4_an_out_that_cannot_be_is_one_line(tmp_path, capsys, out):
    (tmp_path / "file").write_text("mine")
    path = table(tmp_path / "a.npz")
    for command in (["diagnose", str(path)], ["render"], ["film"], ["stress"], ["trade"]):
        assert main([*command, "--out", str(tmp_path / out)]) == 2
        told = capsys.readouterr().err
        assert "cannot be" in told
        assert told.count("\n") == 1


def falling(monkeypatch, tmp_path, error: BaseException) -> None:
    """Let a verb raise this where nobody expects it."""

    def raised(_config):
        raise error

    monkeypatch.setattr(falls.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(verb, "diagnose", raised)


def test_what_nobody_foresaw_is_one_line_with_the_place_of_its_traceback(
    tmp_path, monkeypatch, capsys
):
    falling(monkeypatch, tmp_path, ZeroDivisionError("a\nb"))
    assert main(["diagnose", "a.csv"]) == 1
    told = capsys.readouterr().err
    (kept,) = tmp_path.glob("vidphys-*.txt")
    assert told.startswith("error: vidphys diagnose: ZeroDivisionError: a b; this is a mistake of")
    assert str(kept) in told
    assert "report it" in told
    assert told.count("\n") == 1
    assert "raise error" in kept.read_text()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "runs/a"), "runs/a: No space left on"),
        (RuntimeError("I/O error: no room (os error 28)"), "No space left on device"),
        (MemoryError(), "memory ran out"),
    ],
)
def test_f4_f8_what_is_short_is_said_and_nothing_is_called_a_mistake(
    tmp_path, monkeypatch, capsys, error, said
):
    falling(monkeypatch, tmp_path, error)
    assert main(["diagnose", "a.csv"]) == 1
    told = capsys.readouterr().err
    assert said in told
    assert "mistake" not in told
    assert "the same command goes on from here" in told


def test_a_traceback_that_cannot_be_kept_is_told_by_its_line(tmp_path, monkeypatch, capsys):
    falling(monkeypatch, tmp_path / "nowhere", RuntimeError("x"))
    assert main(["diagnose", "a.csv"]) == 1
    assert "test_verbs.py, line " in capsys.readouterr().err


def test_an_output_that_nobody_reads_ends_quietly():
    command = [sys.executable, "-m", "vidphys", "doctor"]
    reading, writing = os.pipe()
    os.close(reading)
    ended = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False, timeout=90)
    os.close(writing)
    assert ended.returncode == falls.UNREAD
    assert ended.stderr == b""


def test_f10_a_drawing_that_fails_is_warned_of_and_the_numbers_stay(tmp_path, monkeypatch, capsys):
    def broken(*_args, **_options):
        raise RuntimeError("no viewer\nhere")

    monkeypatch.setattr("viz.figures.save_svg", broken)
    monkeypatch.setattr("vidphys.cli.drawing.LIBRARIES", ())  # this process draws
    path, run = table(tmp_path / "a.npz"), tmp_path / "run"
    assert main(["diagnose", str(path), "--out", str(run), "--quiet"]) == 0
    told = capsys.readouterr()
    line = "warning: the diagnosis could not be drawn (RuntimeError: no viewer here)\n"
    assert told.err.count(line) == 1
    assert (run / "records.parquet").exists()
    assert str(run / "summary.txt") in told.out


def test_f10_what_the_user_asked_to_be_drawn_is_no_mere_warning():
    with pytest.raises(InputError, match="--video"), Console(True, 1, "x").drawing("it"):
        raise InputError("--video a.txt: not a video")


def test_f10_no_verb_draws_before_its_numbers_are_kept():
    """Every drawing of a run stands behind the guard, and that after the numbers.

    A table's diagnosis is drawn at the same time by another process, which cannot hurt them.
    """
    home = Path(cli.__file__).parent
    for name, numbers in (
        ("diagnose", "_keep(run, config"),
        ("train", "run.finish("),
        ("fit", "run.join()"),
        ("rollout", '_write(run.path / "rollout.npz"'),
        ("fitted", '_write(run.path / "rollout.npz"'),
        ("ladder", "run.join()"),
    ):
        text = (home / f"{name}.py").read_text(encoding="utf-8")
        assert 0 < text.index(numbers) < text.index(".drawing("), name


def test_libraries_of_unlike_builds_are_named(capsys):
    assert falls.fallen("train", RuntimeError("operator torchvision::nms does not exist")) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "torchvision" in said and "same index" in said


def test_a_choice_before_anything_was_measured_says_what_to_do(tmp_path, capsys):
    assert main(["trade", "--pick", "ms_per_clip<=20", "--out", str(tmp_path / "none")]) == 2
    assert "run `vidphys trade` first" in capsys.readouterr().err
