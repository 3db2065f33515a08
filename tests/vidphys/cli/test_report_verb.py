"""The verb report: any run's page anew, and several ladders beside each other."""

import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.viz.test_viz import SCHEMA, make_run
from vidphys.cli import main
from vidphys.runs.folder import RunFolder

SUMMARY = """1 clip of 40 frames, 1 body in 2 dimensions, 0.1 s between frames
Frames 0 to 39 of 40 are used.
Explained: the law has 99.9 % of the motion and foretells all of the 1.2 s held out.
The body hangs from a pivot.
  length 1.2 \u00b1 0.1 m (95 %)
Not certain, record longer or with less noise: dry friction (40%).
A coordinate has a noise of 0.1 px.
"""


def diagnosed(path: Path) -> Path:
    settings = {"experiment": "diagnose", "input": "swing.csv", "cells": ["diagnosis"]}
    RunFolder.open(path, settings)
    (path / "summary.txt").write_text(SUMMARY)
    numbers = {"length": {"value": 1.2, "standard_error": 0.05, "unit": "m"}}
    mechanism = [{"bodies": [0], "quantities": numbers}]
    (path / "diagnosis.json").write_text(json.dumps({"mechanism": mechanism}))
    (path / "specification.json").write_text("{}")
    return path


def test_a_diagnosis_says_what_holds_and_what_is_open(tmp_path, capsys):
    run = diagnosed(tmp_path / "swing")
    assert main(["report", str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"] == str(run / "report.html")
    page = (run / "report.html").read_text()
    first = re.findall(r"<li><b>(.*?)</b> (.*?)</li>", page)[:3]
    assert [lead for lead, _ in first] == ["Asked:", "Holds:", "Open:"]
    assert "swing.csv. Frames 0 to 39 of 40" in first[0][1]
    assert "foretells all" in first[1][1] and "hangs from a pivot" in first[1][1]
    assert first[2][1].startswith("Not certain")
    assert "1.200 \u00b1 0.098" in page and "<td>m</td>" in page
    assert "vidphys fit TRACKS --specification" in page


def test_a_rollout_is_drawn_from_its_arrays(tmp_path):
    run = tmp_path / "rolled"
    settings = {"experiment": "rollout", "beyond": 2.0, "coupling": -1.0, "law": ["friction=0"]}
    RunFolder.open(run, settings)
    times, later = np.arange(20) * 0.1, 2 + np.arange(10) * 0.1
    track, rolled = np.random.default_rng(0).standard_normal((2, 20, 2, 2))
    arrays = {"times": times, "track": track, "rollout_times": later, "rollout": rolled[:10]}
    np.savez(run / "rollout.npz", **arrays, changed=rolled[10:])
    assert main(["report", str(run)]) == 0
    page = (run / "report.html").read_text()
    assert "G = \u22121, friction times 0" in page and page.count("<svg") == 1
    assert (run / "figures" / "rollout.svg").is_file()


def test_changed_verdicts_come_first(tmp_path, capsys):
    before, after = (make_run(tmp_path / name, 2) for name in ("before", "after"))
    rows = pq.read_table(after / "records.parquet").to_pylist()
    for row in rows:
        if row["cell"] == "renderer/factored" and row["readout"] == "shooting":
            row["value"] = 0.9 if row["metric"] == "ballistic_skill" else row["value"]
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), after / "records.parquet")
    out = tmp_path / "compared"
    assert main(["report", str(before), str(after), "--out", str(out)]) == 0
    page = (out / "comparison.html").read_text()
    assert "1 verdicts differ: renderer \u00b7 shooting / factored." in page
    names = re.findall(r'<th scope="row" class="head">(.*?)</th>', page)
    assert names[0] == "renderer \u00b7 shooting / factored" and len(names) == 10
    assert page.count('class="changed"') == 1
    drawn = re.findall(r'<circle class="run(\d)"[^>]*r="5"><title>(.*?)</title>', page)
    assert drawn[:2] == [("0", "before"), ("1", "after")]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [([], "RUN"), (["/nowhere"], "not the folder of a run"), (["/nowhere", "--out", "x"], "--out")],
)
def test_wrong_input_is_said(arguments, words, capsys):
    assert main(["report", *arguments]) == 2
    assert words.lower() in capsys.readouterr().err.lower()
