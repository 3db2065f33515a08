"""A run folder as an object: everything that was kept, and one line where something was not."""

import re
from html import unescape

import pytest
import torch
from safetensors.torch import save_file

from dynamics import HEADS, Parameters, PhaseState, build, terms, to_config
from vidphys.errors import InputError
from vidphys.opened import open_run
from vidphys.runs import checkpoint
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import Origin, Recorder

STEPS = {"oracle/unstructured": 0.002, "renderer/unstructured": 0.01}  # seconds


def keep_head(folder, where, name="unstructured", **told):
    torch.manual_seed(len(where))
    head = build(HEADS[name], 3, 1.0)
    meta = {"step": 0, "terms": to_config(HEADS[name]), "bodies": 3, **told}
    checkpoint.save(folder.path / "checkpoints" / where / "head.json", head.state_dict(), meta)
    return head


@pytest.fixture
def folder(tmp_path):
    cells = [*STEPS, "hiera/factored"]
    settings = {"cells": cells, "seeds": [0], "scene": {"dt_seconds": 0.002}}
    found = RunFolder.open(tmp_path / "run", settings)
    found.skip("hiera/factored", "no weights")
    return found


def test_tables_are_those_of_the_records(folder):
    run = open_run(str(folder.path))
    with pytest.raises(InputError, match="nothing is finished"):
        _ = run.records
    origin = Origin("ladder", "oracle/unstructured", *("none",) * 5, "unstructured", 0, "cpu", "f")
    recorder = Recorder(origin)
    recorder.add_value("drift", 0.5)
    recorder.add_episodes("drift", torch.tensor([0.25, 0.75]))
    folder.finish("oracle", *recorder.tables())
    folder.join()
    assert run.records["value"].to_pylist() == [0.5]
    assert run.episodes["value"].to_pylist() == [0.25, 0.75]
    assert run.settings["cells"] == [*STEPS, "hiera/factored"]
    assert run.skipped == {"hiera/factored": "no weights"}
    assert run.manifest["versions"]["torch"]


@pytest.mark.parametrize(
    "cell, where, readout",
    [
        ("oracle/unstructured", "oracle-unstructured-s0", None),
        ("renderer/unstructured", "renderer-unstructured-s0/shooting", None),
        ("renderer/unstructured", "renderer-unstructured-s0/differencing", "differencing"),
    ],
)
def test_a_head_is_rebuilt_with_its_step(folder, cell, where, readout):
    kept = keep_head(folder, where)
    head = open_run(folder.path).head(cell, readout=readout)
    assert head.dt == STEPS[cell]
    assert not head.training
    assert all(torch.equal(a, b) for a, b in zip(kept.parameters(), head.parameters(), strict=True))
    tensors = open_run(folder.path).tensors(f"{where}/head")
    assert tensors.keys() == kept.state_dict().keys()


def test_a_head_that_was_kept_with_its_step_has_it(folder):
    keep_head(folder, "oracle-unstructured-s0", dt=0.125)
    assert open_run(folder.path).head("oracle/unstructured").dt == 0.125


def test_a_fitted_head_counts_in_its_own_units(folder):
    term = terms.Hamiltonian(potentials=(terms.Trap(3.0),))
    kept = build(term.counted_in(2.0, 0.5), 2, 0.01, space=3)
    about = {"terms": to_config(term), "bodies": 2, "space": 3}
    meta = {"step": 0, **about, "units": {"length": 2.0, "seconds": 0.5}}
    checkpoint.save(folder.checkpoints("heads") / "specified.json", kept.state_dict(), meta)
    state = PhaseState(torch.ones(1, 2, 3), torch.ones(1, 2, 3))
    law = Parameters(torch.ones(1), torch.ones(1, 2))
    head = open_run(folder.path).head("tracks/specified")
    assert torch.equal(head.force(state, law), kept.force(state, law))


def test_what_is_not_there_is_said_with_what_is(folder):
    keep_head(folder, "oracle-unstructured-s0")
    run = open_run(folder.path)
    with pytest.raises(InputError, match="there are: oracle-unstructured-s0/head"):
        run.head("oracle/factored")
    with pytest.raises(InputError, match="no head of oracle/unstructured 'shooting/head'"):
        run.head("oracle/unstructured", readout="shooting")
    with pytest.raises(InputError, match="no part 'oracle'"):
        run.tensors("oracle")
    with pytest.raises(InputError, match="no trained pipeline"):
        run.pipeline()
    with pytest.raises(InputError, match="not the folder of a run"):
        open_run(folder.path / "checkpoints")


def test_showcases_and_recordings_by_cell(folder):
    shown = folder.showcase("oracle/unstructured")
    shown.parent.mkdir()
    save_file({"times": torch.arange(3.0)}, shown)
    run = open_run(folder.path)
    assert run.recordings == {"oracle-unstructured": shown}
    assert run.tensors("showcase/oracle-unstructured")["times"].tolist() == [0, 1, 2]


def test_nothing_is_written(folder):
    keep_head(folder, "oracle-unstructured-s0")
    before = sorted((p, p.stat().st_mtime_ns) for p in folder.path.rglob("*"))
    run = open_run(folder.path)
    run.head("oracle/unstructured")
    _ = run.parts, run.recordings, run.skipped
    assert before == sorted((p, p.stat().st_mtime_ns) for p in folder.path.rglob("*"))


def test_a_notebook_shows_the_report_and_before_it_the_settings(folder):
    run = open_run(folder.path)
    shown = run._repr_html_()
    assert "<th>seeds</th><td>[0]</td>" in shown and "iframe" not in shown
    page = '<p title="a">nMSE &lt; 0.5</p><script>parent.x = 1</script>'
    (folder.path / "report.html").write_text(page, encoding="utf-8")
    shown = run._repr_html_()
    held = re.fullmatch(
        r'<iframe sandbox="allow-scripts" style="[^"]*" srcdoc="([^"]*)"></iframe>', shown
    )
    assert unescape(held[1]) == page
