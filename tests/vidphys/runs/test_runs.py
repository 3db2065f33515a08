"""The run folder: resumes, extends, refuses, and is never half-written."""

import json
import re
import subprocess
import warnings
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import torch

import vidphys
from vidphys.errors import InputError
from vidphys.runs.asked import asked_of
from vidphys.runs.atomic import write_with
from vidphys.runs.code import code_version
from vidphys.runs.folder import FILES, FOLDERS, MixedCodeWarning, RunFolder
from vidphys.runs.records import Origin, Recorder
from vidphys.summary import Summary

SETTINGS = {"preset": "quick", "cells": ["a/b"], "seeds": [0], "sizes": (1, 2)}


def recorder(seed: int = 0) -> Recorder:
    origin = Origin("ladder", "a/b", "s", "a", "none", "none", "none", "b", seed, "cpu", "f32")
    made = Recorder(origin)
    made.add("inversion_nmse", Summary(0.5, "ok", 4, 0), -1.0, 150)
    made.add("inversion_nmse", Summary(None, "failed", 4, 2), -1.5, 150)
    made.reading("shooting").add_episodes("energy_drift", torch.tensor([1.0, float("nan")]))
    return made


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_what_is_not_finite_is_recorded_as_a_failure(value):
    made = recorder()
    made.add_value("m", value)
    made.add("m", Summary(value, "ok", 4, 1))
    for row, counts in zip(made.rows[-2:], [(0, 0), (4, 1)], strict=True):
        assert (row["value"], row["status"]) == (None, "failed")
        assert (row["episodes"], row["nonfinite"]) == counts


def test_parts_join_and_failures_have_no_number(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    assert not run.is_done("a-b-s0")
    for seed in (0, 1):
        run.finish(f"a-b-s{seed}", *recorder(seed).tables())
    assert run.is_done("a-b-s0")
    records = run.join().to_pylist()
    assert sorted(r["seed"] for r in records) == [0, 0, 1, 1]
    assert {(r["value"], r["status"]) for r in records} == {(0.5, "ok"), (None, "failed")}
    episodes = pq.read_table(tmp_path / "r" / "episodes.parquet").to_pylist()
    assert [(e["value"], e["status"]) for e in episodes[:2]] == [(1.0, "ok"), (None, "failed")]
    assert {e["readout"] for e in episodes} == {"shooting"}


def test_records_say_what_their_seed_is_for_and_which_code_made_them(tmp_path, monkeypatch):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    for seed in (0, 2, 3, 99, 100):
        run.finish(f"a-b-s{seed}", *recorder(seed).tables())
    rows = run.join().to_pylist()
    confirmed = {row["seed"] for row in rows if row["role"] == "confirmation"}
    assert confirmed == {100} and {row["role"] for row in rows} == {"confirmation", "development"}
    assert {(row["code_version"], row["stale"]) for row in rows} == {(code_version(), False)}
    monkeypatch.setattr("vidphys.runs.origin.code_hash", lambda _: "other")
    run.finish("a-b-s101", *recorder(101).tables())
    found = {row["seed"]: row["stale"] for row in run.join().to_pylist()}
    assert found == {0: True, 2: True, 3: True, 99: True, 100: True, 101: False}
    episodes = pq.read_table(tmp_path / "r" / "episodes.parquet").to_pylist()
    assert {row["role"] for row in episodes if row["seed"] == 101} == {"confirmation"}


def test_a_part_of_an_older_run_is_read_and_counts_as_stale(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    run.finish("a-b-s0", *recorder(0).tables())
    file = tmp_path / "r" / "parts" / "a-b-s0.records.parquet"
    pq.write_table(pq.read_table(file).replace_schema_metadata(), file)
    (row, _) = run.join().to_pylist()
    assert (row["role"], row["code_version"], row["stale"]) == ("development", None, True)


def test_a_run_keeps_what_seeds_each_cell_was_asked_for(tmp_path):
    older = {"cells": ["a/b"], "seeds": [0, 1]}  # does not say it
    RunFolder.open(tmp_path / "r", older)
    more = {"cells": ["c/d"], "seeds": [100], "asked": {"c/d": [100]}}
    RunFolder.open(tmp_path / "r", more)
    again = RunFolder.open(tmp_path / "r", {**more, "asked": {"c/d": [101]}})
    settings = again.manifest()["settings"]
    assert settings["asked"] == {"a/b": [0, 1], "c/d": [100, 101]} == asked_of(settings)
    assert asked_of(older) == {"a/b": [0, 1]}


def test_the_same_settings_resume_and_more_cells_extend(tmp_path):
    path = tmp_path / "r"
    created = RunFolder.open(path, SETTINGS).manifest()["created"]
    more = {**SETTINGS, "cells": ["c/d"], "seeds": [1]}
    manifest = RunFolder.open(path, more).manifest()
    assert manifest["created"] == created
    assert manifest["settings"]["cells"] == ["a/b", "c/d"]
    assert manifest["settings"]["seeds"] == [0, 1]


def test_rungs_extend_a_run_and_their_settings_are_what_makes_it(tmp_path):
    path, rungs = tmp_path / "r", {"a": {"rate": 0.1, "sizes": (1, 2)}}
    RunFolder.open(path, SETTINGS)  # of before there were any
    RunFolder.open(path, {**SETTINGS, "rungs": rungs})
    manifest = RunFolder.open(path, {**SETTINGS, "rungs": {"b": {}}}).manifest()
    assert manifest["settings"]["rungs"] == {"a": {"rate": 0.1, "sizes": [1, 2]}, "b": {}}
    with pytest.raises(InputError, match="other settings"):
        RunFolder.open(path, {**SETTINGS, "rungs": {"a": {"rate": 0.2, "sizes": (1, 2)}}})


def test_other_code_that_goes_on_with_a_run_says_so_and_marks_it(tmp_path, monkeypatch):
    path = tmp_path / "r"
    made = "vidphys.runs.folder.code_version", "vidphys.runs.origin.code_version"
    for name in made:
        monkeypatch.setattr(name, lambda: "aaa")
    run = RunFolder.open(path, SETTINGS)
    run.finish("a-b-s0", *recorder().tables())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "mixed_code" not in RunFolder.open(path, SETTINGS).manifest()
    for name in made:
        monkeypatch.setattr(name, lambda: "bbb")
    with pytest.warns(MixedCodeWarning, match=r"this is code bbb.* \(1 of 1\), by aaa"):
        run = RunFolder.open(path, SETTINGS)
    assert run.manifest()["mixed_code"] == ["aaa", "bbb"]
    run.finish("a-b-s1", *recorder(1).tables())
    assert run.join().schema.metadata is None
    assert run.manifest()["made_by"] == {"a-b-s0": "aaa", "a-b-s1": "bbb"}


def test_parts_of_before_they_named_their_code_are_joined(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    run.finish("a-b-s0", *recorder().tables())
    for file in (run.path / "parts").iterdir():
        pq.write_table(pq.read_table(file).replace_schema_metadata(), file)
    run.finish("a-b-s1", *recorder(1).tables())
    assert run.join().num_rows == 4
    assert list(run.manifest()["made_by"]) == ["a-b-s1"]


def test_another_run_is_not_overwritten_unless_asked(tmp_path):
    path = tmp_path / "r"
    run = RunFolder.open(path, SETTINGS)
    run.finish("a-b-s0", *recorder().tables())
    other = {**SETTINGS, "preset": "paper"}
    with pytest.raises(InputError, match="`overwrite`"):
        RunFolder.open(path, other)
    assert run.is_done("a-b-s0")
    again = RunFolder.open(path, other, overwrite=True)
    assert not again.is_done("a-b-s0")
    assert again.manifest()["settings"]["preset"] == "paper"


def test_a_folder_that_is_not_a_run_is_left_alone(tmp_path):
    (tmp_path / "precious.txt").write_text("x")
    with pytest.raises(InputError, match="not a run"):
        RunFolder.open(tmp_path, SETTINGS, overwrite=True)
    assert (tmp_path / "precious.txt").exists()


def test_an_empty_run_has_nothing_to_report(tmp_path):
    with pytest.raises(InputError, match="no finished work"):
        RunFolder.open(tmp_path / "r", SETTINGS).join()


def test_skips_are_noted_once(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    run.skip("x/y", "no weights")
    run.skip("x/y", "no weights")
    assert run.manifest()["skipped"] == [{"cell": "x/y", "reason": "no weights"}]


def test_a_write_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "f.json"
    path.write_text(json.dumps({"old": True}))

    def half(partial):
        partial.write_text("{")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_with(path, half)
    assert json.loads(path.read_text()) == {"old": True}
    assert [p.name for p in tmp_path.iterdir()] == ["f.json"]


def test_a_run_that_could_not_begin_leaves_nothing_and_finished_work_stays(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    run.abandon()
    assert not run.path.exists()
    kept = RunFolder.open(tmp_path / "k", SETTINGS)
    kept.finish("a-b-s0", *recorder().tables())
    kept.abandon()
    assert kept.is_done("a-b-s0")
    other = RunFolder.open(tmp_path / "o", SETTINGS)
    (other.path / "notes.md").write_text("mine")
    other.abandon()
    assert [p.name for p in other.path.iterdir()] == ["notes.md"]


def test_a_run_that_is_given_up_takes_along_whatever_any_verb_writes():
    written = re.compile(r'run\.path / "([^"]+)"')
    source = "".join(p.read_text() for p in Path(vidphys.__file__).parent.rglob("*.py"))
    names = set(written.findall(source))
    assert {"diagnosis.json", "outcomes", "points.parquet"} <= names
    assert names <= {*FOLDERS, *FILES}


def test_a_checkouts_code_is_known_by_its_commit():
    home = Path(__file__).resolve().parents[3]
    if not (home / ".git").exists():
        pytest.skip("not a source checkout")
    command = ["git", "-C", str(home), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert code_version().removesuffix("+dirty") == commit
