"""The tutorial and the examples are run as they stand; the site is built with no broken link."""

import json
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from vidphys.cli import main

ROOT = Path(__file__).parents[2]
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
LONG = ("flip_a_law",)  # the tutorial changes a law as well


@pytest.mark.timeout(600)
def test_the_tutorial_leads_from_nothing_to_a_changed_law(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for language, body in re.findall(r"```(\w+)\n(.*?)```", TUTORIAL, re.S):
        if language == "python":
            exec(compile(body, "tutorial.md", "exec"), {})
            continue
        for line in filter(str.strip, body.splitlines()):
            verb, *rest = shlex.split(line, comments=True)
            assert verb == "vidphys" and main(rest) == 0, line
    data = json.loads((tmp_path / "runs/diagnosed/diagnosis.json").read_text())
    numbers = {
        name: q["value"] for part in data["mechanism"] for name, q in part["quantities"].items()
    }
    told = capsys.readouterr().out
    assert data["status"] == "explained", told
    assert any(abs(value - 0.24) < 0.02 for name, value in numbers.items() if "friction" in name)
    for run in ("diagnosed", "fitted", "changed"):
        assert (tmp_path / "runs" / run / "report.html").is_file()


def test_there_are_five_examples():
    assert len(EXAMPLES) == 5


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=pytest.mark.slow if p.stem in LONG else ()) for p in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_an_example_runs_and_says_what_it_found(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    said = capsys.readouterr().out
    assert said.strip() and "False" not in said and "nan" not in said
    ratio = re.search(r"without any force: ([\d.]+)", said)
    assert ratio is None or float(ratio[1]) < 0.5


@pytest.mark.timeout(300)
def test_the_site_is_built_strictly(tmp_path):
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "-q",
        "-d",
        str(tmp_path / "site"),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    page = (tmp_path / "site" / "reference" / "cli.html").read_text(encoding="utf-8")
    assert "vidphys diagnose" in page and "--hold-out" in page
    columns = (tmp_path / "site" / "reference" / "records.html").read_text(encoding="utf-8")
    assert "<code>nonfinite</code>" in columns
    api = (tmp_path / "site" / "reference" / "api.html").read_text(encoding="utf-8")
    assert "SoftenedGravity" in api
