"""The command line: exit codes, one-line errors, and imports that cost nothing."""

import subprocess
import sys

import pytest

from vidphys.cli import VERBS, in_options, main
from vidphys.cli.rollout import RolloutConfig

STAGES = ("dynamics", "renderers", "encoders", "binders", "readouts", "loops")
HEAVY = ("cv2", "mujoco", "rerun", "transformers", "timm", "matplotlib", "vidphys", "viz")


def one_line(capsys) -> str:
    err = capsys.readouterr().err.strip()
    assert "\n" not in err and err.startswith("error: ")
    return err


@pytest.mark.parametrize("stage", [*STAGES, "viz"])
def test_importing_a_stage_costs_nothing(stage):
    code = (
        "import socket, sys\n"
        "def refuse(*a, **k): raise OSError('network')\n"
        "socket.socket.connect = refuse\n"
        f"import {stage}\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules and m != {stage!r}])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=100
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_an_example(verb, capsys):
    with pytest.raises(SystemExit) as stop:
        main([verb, "--help"])
    assert stop.value.code == 0
    assert "Example:" in capsys.readouterr().out


def test_no_verb_and_an_unknown_verb(capsys):
    assert main(["--help"]) == 0
    assert "ladder" in capsys.readouterr().out
    assert main(["fly"]) == 2
    assert "no such verb" in one_line(capsys)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["ladder", "--cells", "orcale"], "did you mean 'oracle'"),
        (["ladder", "--heads", "x"], "--heads x: unknown"),
        (["ladder", "--seeds", "0"], "at least one seed"),
        (["ladder", "--seed", "-1"], "--seed -1: a seed is 0 or more"),
        (["ladder", "--workers", "0"], "at least one process"),
        (["ladder", "--device", "cuda"], "--device cuda"),
        (["reproduce"], "name a table, or all"),
        (["reproduce", "invertion"], "did you mean 'inversion'"),
        (["reproduce", "inversion", "--seeds", "0"], "at least one seed"),
        (["reproduce", "inversion", "--workers", "0"], "at least one process"),
        (["reproduce", "inversion", "--device", "cuda"], "--device cuda"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(arguments, words, capsys, tmp_path):
    out = tmp_path / "run"
    assert main([*arguments, "--out", str(out)]) == 2
    assert words in one_line(capsys)
    assert not out.exists()


def test_arguments_are_said_as_the_verb_s_options():
    text = "`run`: holds another; give `beyond`, or `bodies` by `vidphys render`"
    said = in_options(text, RolloutConfig)
    assert said == "run: holds another; give --beyond, or `bodies` by `vidphys render`"


def test_doctor_tells_versions(capsys):
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "torch" in out and "cuda" in out


def test_a_strangers_package_is_named(monkeypatch, capsys, tmp_path):
    (tmp_path / "dynamics").mkdir()
    (tmp_path / "dynamics" / "__init__.py").write_text("")
    code = "from vidphys.cli import main; import sys; sys.exit(main(['doctor']))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=100,
        env={"PYTHONPATH": str(tmp_path), "PATH": ""},
        cwd=tmp_path,
    )
    assert done.returncode == 2 and "not vidphys' own package" in done.stderr
