"""SQL over runs: their numbers, and nothing else of the machine."""

import pytest

from vidphys.errors import InputError
from vidphys.queries import query
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import Origin, Recorder


@pytest.fixture
def runs(tmp_path):
    for name, values in (("a", [0.5, 1.5]), ("b", [3.0]), ("c", [])):
        folder = RunFolder.open(tmp_path / name, {"cells": ["oracle/factored"], "seeds": [0]})
        if not values:
            continue
        origin = Origin("ladder", "oracle/factored", *["none"] * 5, "factored", 0, "cpu", "f")
        recorder = Recorder(origin)
        for k, value in enumerate(values):
            recorder.add_value(f"m{k}", value)
        folder.finish("oracle-factored-s0", *recorder.tables())
        folder.join()
    return [tmp_path / name for name in "abc"]


def test_several_runs_are_one_table(runs):
    asked = "select run, sum(value) total from records group by run order by run"
    found = query(asked, *runs).to_pylist()
    assert found == [{"run": str(runs[0]), "total": 2.0}, {"run": str(runs[1]), "total": 3.0}]
    assert query("select count(*) n from episodes", *runs).to_pylist() == [{"n": 0}]


def test_runs_without_numbers_have_no_rows(runs):
    assert query("select * from records", runs[2]).num_rows == 0
    assert query("select * from records").num_rows == 0


@pytest.mark.parametrize(
    "asked",
    [
        "select * from '{}/a/records.parquet'",
        "select * from read_csv('/etc/passwd')",
        "copy (select 1) to '{}/stolen.csv'",
        "attach '{}/new.db'",
        "install httpfs",
        "load httpfs",
        "set enable_external_access = true",
        "select * from runs",
        "selekt",
    ],
)
def test_z12_a_query_reads_and_writes_no_file(runs, asked):
    before = set(runs[0].parent.rglob("*"))
    with pytest.raises(InputError, match="query: ") as caught:
        query(asked.format(runs[0].parent), *runs)
    assert "\n" not in str(caught.value)
    assert set(runs[0].parent.rglob("*")) == before


def test_what_is_no_run_is_named(tmp_path):
    with pytest.raises(InputError, match="not the folder of a run"):
        query("select 1", tmp_path)
