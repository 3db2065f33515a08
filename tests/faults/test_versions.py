"""F12: what other versions wrote, and runs that go on under other packages, threads or machines."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from safetensors.numpy import save_file

from vidphys.cli.recordings import write_arrays
from vidphys.errors import InputError
from vidphys.experiments import study
from vidphys.runs import surroundings
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import read_table, write_table
from vidphys.runs.surroundings import MixedMachineWarning
from vidphys.stress import matrix
from viz.page import read_verdicts
from viz.showcase import ROLES, read_showcase

SETTINGS = {"cells": ["a/b"], "seeds": [0]}
OLD = Path(__file__).parent / "old"


def test_f12_a_run_says_its_threads_and_instructions(tmp_path):
    made = RunFolder.open(tmp_path / "r", SETTINGS).manifest()
    assert made["machine"]["threads"] == torch.get_num_threads()
    assert made["machine"]["instructions"] == torch.backends.cpu.get_cpu_capability()
    assert made["versions"]["torch"] == torch.__version__.split("+")[0] or made["versions"]["torch"]


def test_a_run_in_which_torch_computes_nothing_does_not_load_it(tmp_path):
    code = (
        "import sys; from pathlib import Path; from vidphys.runs.folder import RunFolder\n"
        f"with RunFolder.at_work(Path(sys.argv[1]), {SETTINGS}, threads=0) as run: pass\n"
        "assert 'torch' not in sys.modules and set(run.manifest()['machine']) == {'processor'}"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "r")], check=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        RunFolder.open(tmp_path / "r", SETTINGS)  # what was not said then has not changed


@pytest.mark.parametrize(
    ("patched", "value", "name"),
    [
        ("_machine", {"threads": 7, "instructions": "AVX9", "processor": "x"}, "threads"),
        ("_versions", {"torch": "99.0"}, "torch"),
    ],
)
def test_f12_a_run_that_goes_on_elsewhere_is_marked_and_said_once(
    tmp_path, monkeypatch, patched, value, name
):
    begun = RunFolder.open(tmp_path / "r", SETTINGS).manifest()
    was = {**begun["versions"], **begun["machine"]}[name]
    monkeypatch.setattr(surroundings, patched, lambda *_: value)
    with pytest.warns(MixedMachineWarning, match=rf"{name} {value[name]} \(begun with {was}\)"):
        run = RunFolder.open(tmp_path / "r", SETTINGS)
    assert run.manifest()["mixed"][name] == sorted([str(was), str(value[name])])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = RunFolder.open(tmp_path / "r", SETTINGS).manifest()
    assert again["mixed"] == run.manifest()["mixed"]


def test_f12_a_run_json_of_before_it_was_sealed_is_gone_on_with(tmp_path):
    (tmp_path / "run.json").write_bytes((OLD / "run.json").read_bytes())
    with pytest.warns(UserWarning):  # other code and packages than then
        run = RunFolder.open(tmp_path, SETTINGS)
    manifest = run.manifest()
    assert (manifest["schema_version"], manifest["created"]) == (2, "2026-10-01T12:00:00+00:00")


def test_f12_an_edited_run_json_is_refused_by_name(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    text = run.manifest_path.read_text()
    run.manifest_path.write_text(text.replace('"a/b"', '"a/c"'))
    with pytest.raises(InputError, match=r"run\.json: damaged or edited"):
        RunFolder.open(tmp_path / "r", SETTINGS)


def showcase(path: Path, about: dict[str, str] | None) -> None:
    arrays = {"times": np.arange(3.0), "half_extent": np.array(4.0)}
    for role in ROLES:
        arrays |= {role: np.zeros((3, 1, 2)), f"energy_{role}": np.zeros(3)}
    save_file(arrays, path, about)


def test_f12_showcases_of_before_they_were_sealed_are_drawn_and_newer_ones_are_not(tmp_path):
    path = tmp_path / "a.safetensors"
    showcase(path, {"cell": "a"})
    assert read_showcase(path)[1] == {"cell": "a"}
    showcase(path, {"cell": "a", "schema_version": "9", "seal": "0"})
    with pytest.raises(ValueError, match=r"a\.safetensors: schema version 9, this vidphys reads 2"):
        read_showcase(path)


def test_f12_tables_of_before_they_were_hashed_are_read_and_newer_ones_are_not(tmp_path):
    path, table = tmp_path / "a.parquet", pa.table({"x": [1, 2]})
    pq.write_table(table, path)
    assert read_table(path).equals(table)
    pq.write_table(table.replace_schema_metadata({b"schema_version": b"9"}), path)
    with pytest.raises(InputError, match=r"a\.parquet: schema version 9, this vidphys reads 2"):
        read_table(path)
    write_table(path, table)
    marks = pq.read_schema(path).metadata
    assert marks[b"schema_version"] == b"2"
    pq.write_table(table.replace_schema_metadata({b"schema_version": b"2"}), path)
    with pytest.raises(InputError, match=r"a\.parquet: damaged"):  # its hash is gone
        read_table(path)


def test_f12_every_file_of_a_run_says_its_schema(tmp_path):
    assert json.loads((OLD / "run.json").read_text())["schema_version"] == 1
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    assert json.loads(run.manifest_path.read_text())["schema_version"] == 2
    write_arrays(run.path / "rollout.npz", {"track": np.zeros(2)})
    with np.load(run.path / "rollout.npz") as arrays:
        assert int(arrays["schema_version"]) == 2
    table = pa.table({"value": [0.5], "seed": pa.array([0], pa.int64())})
    run.finish("p", table, table)
    for write, held in ((study.write_verdicts, {}), (matrix.write_verdicts, {"counts", "cells"})):
        write(run, [])
        assert json.loads((run.path / "verdicts.json").read_text())["schema_version"] == 2
        _, verdicts = read_verdicts(run.path)
        assert set(verdicts) >= set(held)
        assert "schema_version" not in verdicts


def test_f12_verdicts_of_a_newer_schema_are_not_drawn(tmp_path):
    RunFolder.open(tmp_path / "r", SETTINGS)
    (tmp_path / "r" / "verdicts.json").write_text('{"schema_version": 9}')
    with pytest.raises(ValueError, match="schema version 9, this reads 2"):
        read_verdicts(tmp_path / "r")
