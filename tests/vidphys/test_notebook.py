"""The notebook is run as it stands, in a kernel of its own; each thing shows itself."""

import os
import sys
from pathlib import Path

import nbformat
import pytest
import torch
from nbclient import NotebookClient

import vidphys
from dynamics import Parameters, PhaseState, ballistic
from vidphys.notebook import rollout_html

NOTEBOOK = Path(__file__).parents[2] / "examples" / "first_look.ipynb"


def shown_by(cell):
    return [out.data["text/html"] for out in cell.outputs if "text/html" in out.get("data", {})]


@pytest.mark.timeout(600)
def test_a_notebook_shows_head_rollout_diagnosis_and_run(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert all(not cell.outputs for cell in notebook.cells if cell.cell_type == "code")
    where = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=500, kernel_name="python3", resources=where).execute()
    head, rollout, diagnosis, run = (
        page for cell in notebook.cells if cell.cell_type == "code" for page in shown_by(cell)
    )
    assert "Hamiltonian" in head and "4,417" in head
    assert rollout.count("<polyline") == 3 and "256" in rollout
    assert "trap" in diagnosis and "explained</th><td>yes" in diagnosis
    assert "srcdoc" in run and "Explained" in run


def test_a_rollout_that_failed_is_drawn_as_far_as_it_is_finite():
    start = PhaseState(torch.zeros(2, 1, 1), torch.ones(2, 1, 1))
    law = Parameters(torch.ones(2), torch.ones(2, 1))
    found = vidphys.rollout(ballistic(), start, law, 10, 0.1)
    found.states.q[0, 5:] = float("nan")
    assert len(rollout_html(found).split('points="')[1].split('"')[0].split()) == 5
    found.states.q[0] = float("nan")
    assert "No state is finite" in rollout_html(found)
