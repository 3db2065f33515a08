"""A card gives the same numbers: cells of the study computed on one that is none."""

from dataclasses import replace

import pytest
import torch

from tests.shared.card import a_card
from tests.shared.small_studies import TINY
from vidphys.experiments import ladder
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.scoring import Question, score_changed_law
from vidphys.experiments.pixels import pixel_cell

SIZES = replace(TINY.pixel, encounters=1)
NOT_NUMBERS = ("device", "seconds")


def brief(recorder, head, question):
    """The doors between the card and the CPU that all scores go through, over a few steps."""
    few = replace(question, steps=20)
    score_changed_law(recorder, head, few, few.params.with_coupling(-1.0), few.params, -1.0)
    score_retrace(recorder, head, replace(question, steps=5))
    return few.ask(head, 20)


@pytest.fixture(autouse=True)
def short(monkeypatch):
    def score(head, readout, perceived, recorder):
        question = perceived.seen.asked.starting(readout.start(head, perceived))
        pixel_cell.score_state(recorder, question)
        return question, brief(recorder, head, question)

    monkeypatch.setattr(ladder, "score_oracle", brief)
    monkeypatch.setattr(pixel_cell, "score", score)
    monkeypatch.setattr(Question, "reference", _short_reference)


def _short_reference(question, params, steps=None):
    steps = question.steps if steps is None else steps
    return question.scene.simulate(question.truth, params, steps, question.every)


def rows(table, cell, device, folder=None):
    task = CellTask(table, cell, (0,), TINY.oracle, SIZES, device, folder)
    TABLES[table].cells[cell](task)
    found = [row for each in task.recorders for row in each.tables()[0].to_pylist()]
    assert found and {row["device"].split()[0] for row in found} == {device}
    return [{k: v for k, v in row.items() if k not in NOT_NUMBERS} for row in found]


def same(cell, tmp_path, table="ladder"):
    here = rows(table, cell, "cpu", tmp_path / "cpu")
    with a_card():
        there = rows(table, cell, "cuda", tmp_path / "cuda")
    assert len(here) == len(there)
    for ours, theirs in zip(here, there, strict=True):
        assert {**ours, "value": 0} == {**theirs, "value": 0}
        assert theirs["value"] == pytest.approx(ours["value"], rel=1e-3, abs=1e-6), ours["metric"]


@pytest.mark.parametrize("head", ladder.ALL_HEADS)
def test_every_head_of_the_oracle_is_trained_and_rolled_there(head, tmp_path):
    same(f"oracle/{head}", tmp_path)


@pytest.mark.parametrize(
    "rung",
    [
        "renderer",
        "cnn-supervised",
        "cnn-discovered",
        "jepa-centroid",
        "rgb-tracked",
        "anonymous-hand",
        "anonymous-tracker",
        "anonymous-slots",
        "composed",
        "dino-tiny",
        "dino-tiny-anchored",
    ],
)
def test_every_kind_of_rung_sees_there(rung, tmp_path):
    same(f"{rung}/factored", tmp_path)


def test_a_tensor_of_the_cpu_is_refused_beside_one_of_the_card():
    with a_card(), pytest.raises(RuntimeError, match="same device"):
        torch.ones(2, device="cuda") + torch.ones(2)
