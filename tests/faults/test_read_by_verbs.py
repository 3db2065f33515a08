"""F3: what one verb wrote and another reads: reports, profiles, checkpoints, rollouts."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from tests.faults.test_read_back import undetected
from tests.viz.test_viz import make_run
from vidphys.cli.recordings import write_arrays
from vidphys.data.exports.episodes import STATE, episodes_of
from vidphys.errors import InputError
from vidphys.runs import checkpoint
from vidphys.runs.records import read_table, write_table
from vidphys.runs.sealed import write_sealed
from vidphys.trade.profile import read_profile, write_profile
from viz import kept
from viz.page import read_verdicts
from viz.report import read_play, read_run


@pytest.fixture
def run(tmp_path):
    """A run's folder as the verbs of today leave it."""
    made = make_run(tmp_path / "run", 1)
    about = json.loads((made / "run.json").read_text())
    write_sealed(made / "run.json", {**about, "schema_version": 2}, 2)
    rows = read_table(made / "records.parquet")
    for name in ("records", "episodes"):
        write_table(made / f"{name}.parquet", rows)
    write_sealed(made / "verdicts.json", {"one": {"rows": [1, "x", None]}}, 2)
    write_sealed(made / "play.json", {"law": [0.5, -1.0]}, 2)
    write_sealed(made / "diagnosis.json", {"mechanism": [{"bodies": [0]}]}, 2)
    write_sealed(made / "atlas.json", {"choices": [{"target": "position"}]}, 1)
    return made


@pytest.mark.parametrize("name", ["run.json", "records.parquet", "episodes.parquet"])
def test_f3_no_damaged_file_of_a_run_is_reported(run, name):
    whole = str(read_run(run)[0]), *(str(each.rows) for each in read_run(run)[1:])

    def same(found) -> bool:
        return (str(found[0]), *(str(each.rows) for each in found[1:])) == whole

    assert undetected(run / name, lambda: read_run(run), same, ValueError) == []


@pytest.mark.parametrize("name", ["verdicts.json", "play.json", "diagnosis.json", "atlas.json"])
def test_f3_no_damaged_words_of_a_run_are_reported(run, name):
    path = run / name

    def read():
        if name == "verdicts.json":
            return read_verdicts(run)[1]
        if name == "play.json":
            return read_play(run)
        return kept.words(path, unsealed=0 if name == "atlas.json" else 1)

    whole = read()
    assert whole
    assert undetected(path, read, whole.__eq__, ValueError) == []


def test_f3_no_damaged_profile_sets_anything(tmp_path):
    path = tmp_path / "profile.json"
    write_profile(path, {"cores": 2, "machine": "x"}, [])
    whole = read_profile(path)
    assert undetected(path, lambda: read_profile(path), whole.__eq__, InputError) == []


@pytest.mark.parametrize("reader", ["report", "export"])
def test_f3_no_damaged_rollout_is_drawn_or_exported(tmp_path, reader):
    path = tmp_path / "rollout.npz"
    times, rng = np.arange(20) / 10, np.random.default_rng(0)
    made = {"times": times, "track": rng.standard_normal((20, 1, 2))}
    made |= {"rollout_times": times + 2, "rollout": rng.standard_normal((20, 1, 2))}
    write_arrays(path, made)

    def read():
        if reader == "report":
            return {name: array.tolist() for name, array in kept.arrays(path).items()}
        return [
            (each.name, each.times.tolist(), each.columns[STATE].tolist())
            for each in episodes_of(tmp_path)
        ]

    whole = read()
    assert undetected(path, read, whole.__eq__, ValueError) == []


@pytest.mark.parametrize("name", ["c.json", "c-00000003.safetensors"])
def test_f3_no_damaged_checkpoint_is_rolled(tmp_path, name):
    state = {"memory/values": torch.rand(4, 3), "head": torch.arange(5.0)}
    checkpoint.save(tmp_path / "c.json", state, {"step": 3, "note": "mine"})

    def same(found) -> bool:
        tensors, meta = found
        return meta["step"] == 3 and all(torch.equal(tensors[key], state[key]) for key in state)

    def read():
        return checkpoint.load(tmp_path / "c.json")

    assert same(read())
    assert undetected(tmp_path / name, read, same, InputError) == []
