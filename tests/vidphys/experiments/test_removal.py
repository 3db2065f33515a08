"""Terms taken out, turned round or exchanged: what a model of exact parts, and one without, say."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from dynamics.contact import CutSpring
from dynamics.couplings import PairLaw
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.oracle import held_out_question
from vidphys.experiments.core.question import Question
from vidphys.experiments.linear.removal import (
    CHANGES,
    MODELS,
    NOTHING,
    REMOVAL,
    STIFF,
    changed,
    exchanged,
    score_change,
)
from vidphys.presets import OracleSizes
from vidphys.runs.records import Origin, Recorder
from vidphys.scenes.many_terms import many_terms
from vidphys.scenes.springs import CUTOFF

TINY = OracleSizes(64, 4, 64, (5e-3,), 4)


@pytest.fixture(scope="module")
def usual() -> Question:
    return replace(held_out_question(many_terms(), 4, seed=0), steps=500)


def numbers(head, asked: Question, usual: Question) -> dict[str, float]:
    recorder = Recorder(Origin("removal", "c", "many-terms", "oracle", "none", "none", "none",
                               "parts", 0, "cpu", "float64"))  # fmt: skip
    score_change(recorder, head, asked, usual)
    return {row["metric"]: row["value"] for row in recorder.rows}


@pytest.mark.parametrize("change", sorted(set(CHANGES) - {NOTHING}))
def test_a_model_of_the_exact_parts_answers_each_change(change, usual):
    head, asked = changed(usual.scene.law, usual, CHANGES[change])
    found = numbers(head, asked, usual)
    assert found["inversion_nmse"] < 1e-10  # rolled in float32
    assert found["truth_distance"] > 0.02  # the change is one that can be seen


@pytest.mark.parametrize("change", ["field-removed", "drag-tripled", "trap-removed"])
def test_what_goes_on_as_before_misses_all_of_a_change(change, usual):
    _, asked = changed(usual.scene.law, usual, CHANGES[change])
    assert numbers(usual.scene.law, asked, usual)["change_missed"] == pytest.approx(1, abs=1e-6)


def test_a_model_without_terms_is_left_as_it_is_but_told_the_coupling(usual):
    head = usual.scene.build(MODELS["unstructured"])
    same, asked = changed(head, usual, CHANGES["drag-removed"])
    assert same is head
    _, asked = changed(head, usual, CHANGES["pair-flipped"])
    assert torch.equal(asked.params.coupling, -usual.params.coupling)


def test_nothing_changed_has_no_share_that_is_missed(usual):
    found = numbers(*changed(usual.scene.law, usual, CHANGES[NOTHING]), usual)
    assert set(found) == {"inversion_nmse"}


def test_an_exchanged_pair_law_is_the_lender_s(usual):
    lender = many_terms(CutSpring(CUTOFF, PairLaw("alike")))
    asked = replace(usual, scene=lender, params=usual.params.with_coupling(STIFF))

    class Lent:
        potential = lender.law.potential.parts[0]

    found = numbers(exchanged(usual.scene.law, Lent()), asked, usual)
    assert found["inversion_nmse"] < 1e-10  # rolled in float32
    assert found["truth_distance"] > 0.03
    assert many_terms().law.potential.parts[0] is not Lent.potential


@pytest.mark.parametrize("cell", ["parts", "exchanged"])
def test_cells_leave_their_records_for_each_seed(cell, monkeypatch):
    monkeypatch.setattr("vidphys.experiments.core.oracle.OLDEST", 100)
    monkeypatch.setattr("vidphys.experiments.linear.removal.STEPS", 20)
    task = CellTask("removal", cell, (0, 1), TINY)
    REMOVAL.cells[cell](task)
    rows = [row for recorder in task.recorders for row in recorder.rows]
    missed = [row for row in rows if row["metric"] == "change_missed"]
    assert len(missed) == 2 * (len(CHANGES) - 1 if cell == "parts" else 1)
    assert all(row["value"] > 0 for row in missed)
