"""The command line: exit codes, one-line errors, and imports that cost nothing."""

import importlib
import re
import subprocess
import sys
from dataclasses import fields
from types import SimpleNamespace

import pytest
import torch

from vidphys.cli import VERBS, in_options, main
from vidphys.cli.console import Console
from vidphys.cli.helped import ORDER, options_of
from vidphys.cli.rollout import RolloutConfig
from vidphys.cli.study import measured
from vidphys.experiments.core.cell import Unit

STAGES = ("dynamics", "renderers", "encoders", "binders", "readouts", "loops")
HEAVY = ("cv2", "mujoco", "rerun", "transformers", "timm", "matplotlib", "vidphys", "viz")


def one_line(capsys) -> str:
    err = capsys.readouterr().err.strip()
    assert "\n" not in err and err.startswith("error: ")
    return err


def test_importing_a_stage_costs_nothing():
    """One after the other: what none may import is then the first one's that did."""
    code = (
        "import importlib, socket, sys\n"
        "def refuse(*a, **k): raise OSError('network')\n"
        "socket.socket.connect = refuse\n"
        f"for stage in {(*STAGES, 'viz')!r}:\n"
        "    module = importlib.import_module(stage)\n"
        "    [getattr(module, name) for name in module.__all__]\n"
        f"    print(stage, [m for m in {HEAVY!r} if m in sys.modules and m != stage])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=200
    )
    assert done.stdout.splitlines() == [f"{stage} []" for stage in (*STAGES, "viz")]


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_an_example(verb, capsys):
    assert main([verb, "--help"]) == 0
    told = capsys.readouterr().out
    assert "Example:" in told and "None" not in told
    config = getattr(importlib.import_module(f"vidphys.cli.{verb}"), VERBS[verb][0])
    for field, option in zip(fields(config), options_of(config), strict=True):
        assert option.text and option.written in told
        if type(field.default) in (int, float, str) and field.default != "":
            assert f"(default: {field.default})" in option.text


def test_options_stand_in_groups_with_their_kinds(capsys):
    assert main(["help", "train"]) == 0
    told = capsys.readouterr().out
    groups = dict(part.split(":\n", 1) for part in told.split("\n\n") if ":\n  --" in part)
    assert list(groups) == [title for title in ORDER if title in groups] and len(groups) == 7
    assert "--encoder TEXT" in groups["The encoder"] and "--at TEXT" in groups["Which bodies"]
    assert "--no-mirrors" in groups["Sizes and steps"] and "--mirrors" not in told.split()


def test_no_verb_and_an_unknown_verb(capsys):
    assert main(["--help"]) == 0
    assert "ladder" in capsys.readouterr().out
    assert main(["fly"]) == 2
    assert "no such verb" in one_line(capsys)
    assert main(["diagnos"]) == 2
    assert "did you mean diagnose?" in one_line(capsys)


def test_the_version_and_help_by_name(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"vidphys \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)
    assert main(["help", "doctor"]) == 0
    assert "vidphys doctor" in capsys.readouterr().out
    assert main(["help"]) == 0


def test_a_shell_completes_every_verb(capsys, tmp_path):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert all(verb in script for verb in VERBS) and "--preset" in script
    (tmp_path / "it").write_text(script)
    subprocess.run(["bash", "-n", tmp_path / "it"], check=True, timeout=60)


def test_progress_tells_count_share_and_time_left(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr("vidphys.cli.console.time", SimpleNamespace(monotonic=lambda: now[0]))
    with Console(False, 4, "ladder") as console:
        now[0] = 20.0
        console.done(0)
    first, second = capsys.readouterr().err.splitlines()
    assert "0 of 4 units finished" in first
    assert second == "[ladder     20 s] 1 of 4 units finished (25%), about 60 s left"


class Finished:
    """A run folder in which some parts are done, and some cells were skipped."""

    def __init__(self, done, skipped):
        self.done, self.skipped = done, skipped

    def is_done(self, part):
        return part in self.done

    def manifest(self):
        return {"skipped": [{"cell": c, "reason": r} for c, r in self.skipped.items()]}


def test_what_was_measured_is_told_of_what_was_asked():
    units = [
        Unit(
            "ladder", (f"{rung}/a", f"{rung}/b"), (seed,), (f"{rung}-a-{seed}", f"{rung}-b-{seed}")
        )
        for seed in (0, 1)
        for rung in ("oracle", "hiera", "dinov2")
    ]
    every = {part for unit in units for part in unit.parts}
    assert measured(Finished(every, {}), units) == "6 cells"
    absent = {
        f"ladder/{rung}/{head}": "skipped: no weights"
        for rung in ("hiera", "dinov2")
        for head in "ab"
    }
    some = {part for part in every if part.startswith("oracle")}
    said = measured(Finished(some, absent), units)
    assert said == "2 of 6 cells; 2 rungs skipped: no weights"
    lost = measured(
        Finished(some - {"oracle-b-1"}, {**absent, "ladder/oracle/b": "failed: x"}), units
    )
    assert lost == "1 of 6 cells; 2 rungs skipped: no weights; 1 failed"


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


def test_doctor_says_whether_bytecode_is_kept(tmp_path, monkeypatch, capsys):
    kept = tmp_path / "torch.pyc"
    monkeypatch.setattr(torch.__spec__, "cached", str(kept))
    main(["doctor"])
    assert "PYTHONDONTWRITEBYTECODE" in capsys.readouterr().out
    kept.touch()
    main(["doctor"])
    assert "PYTHONDONTWRITEBYTECODE" not in capsys.readouterr().out


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


def test_an_engine_that_is_not_installed_is_told_before_anything_is_written(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["ladder", "--engine", "ray", "--out", str(tmp_path / "x")]) == 2
    assert "pip install 'vidphys[ray]'" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
    assert main(["plan", "ladder", "--cells", "oracle/factored", "--engine", "ray"]) == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ["train", "none"],
        ["rollout", "none", "none.mp4"],
        ["rollout", "run", "none.mp4"],
        ["diagnose", "none.csv"],
    ],
)
def test_what_is_not_there_is_told_before_slow_libraries_are_loaded(tmp_path, arguments):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").touch()
    code = (
        "import sys; from vidphys.cli import main; code = main(sys.argv[1:]); "
        "print(code, 'torch' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.stdout.split() == ["2", "False"] and "none" in done.stderr


def test_a_training_that_was_stopped_is_told_from_a_folder_that_is_none(tmp_path, capsys):
    clip, out = tmp_path / "clip.avi", ["--out", str(tmp_path / "x")]
    clip.touch()
    for given in ([], [str(clip)]):
        assert main(["rollout", str(tmp_path), *given, *out]) == 2
        assert "no folder of `vidphys train` or `fit`" in capsys.readouterr().err
    (tmp_path / "run.json").touch()
    assert main(["rollout", str(tmp_path), *out]) == 2
    assert "give a clip after it" in capsys.readouterr().err
    assert main(["rollout", str(tmp_path), str(clip), *out]) == 2
    assert "its command again" in capsys.readouterr().err
