"""States far apart: the step in the loss, and what is measured of the law that it leaves."""

from __future__ import annotations

import pytest
import torch

from dynamics import INTEGRATORS, Hamiltonian
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.oracle import held_out_question, true_segments
from vidphys.experiments.gravity.sparse import APART, SPARSE, WAYS, score_force
from vidphys.presets import OracleSizes
from vidphys.runs.records import Origin, Recorder
from vidphys.scenes import gravity
from vidphys.training.segments import scale_of, segment_loss

TINY = OracleSizes(64, 4, 64, (5e-3,), 4)


def stepped_by(name: str) -> Hamiltonian:
    """The exact law, with another step."""
    law = gravity().law
    return Hamiltonian(law.kinetic, law.potential, INTEGRATORS[name])


@pytest.mark.parametrize("apart", APART)
def test_stored_states_are_as_far_apart_as_asked(apart):
    once, in_three = (true_segments(gravity(), 16, 0, apart=apart, parts=k).train for k in (1, 3))
    assert once.dt == pytest.approx(0.002 * apart) == pytest.approx(3 * in_three.dt)
    assert (once.every, in_three.every) == (1, 3)
    torch.testing.assert_close(once.q, in_three.q)


def test_a_step_of_fourth_order_leaves_less_of_the_exact_law():
    data = true_segments(gravity(), 64, 0, apart=5).train
    thirds = true_segments(gravity(), 64, 0, apart=5, parts=3).train
    scale = scale_of(data)
    second, fourth = (segment_loss(stepped_by(x), scale)(data) for x in ("leapfrog", "yoshida4"))
    in_three = segment_loss(stepped_by("leapfrog"), scale)(thirds)
    assert in_three < fourth < 0.1 * second  # as many forces buy more in three short steps


@pytest.mark.parametrize(("times", "error"), [(1.0, 0.0), (0.0, 1.0), (-1.0, 4.0)])
def test_the_error_of_a_force_is_over_its_size(times, error):
    question = held_out_question(gravity(), 8, 0)

    class Scaled(torch.nn.Module):
        def force(self, state, params):
            return times * question.scene.law.force(state, params)

    recorder = Recorder(Origin("sparse", "c", "gravity", "oracle", "none", "none", "none",
                               "x", 0, "cpu", "float64"))  # fmt: skip
    score_force(recorder, Scaled(), question)
    (row,) = recorder.rows
    assert row["metric"] == "force_nmse" and row["coupling"] == -1.0
    assert row["value"] == pytest.approx(error, abs=1e-10)


def test_every_way_is_a_cell_at_every_distance_and_leaves_its_records(monkeypatch):
    monkeypatch.setattr("vidphys.experiments.core.oracle.OLDEST", 100)
    assert set(SPARSE.cells) == {f"{w}/{a}" for w in WAYS for a in APART} | {"truth"}
    task = CellTask("sparse", "leapfrog-in-three/10", (0,), TINY)
    SPARSE.cells[task.cell](task)
    (recorder,) = task.recorders
    assert {"force_nmse", "ballistic_skill", "energy_drift_median"} <= {
        row["metric"] for row in recorder.rows
    }
