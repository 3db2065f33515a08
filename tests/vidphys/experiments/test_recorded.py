"""Known motions as tables: paths that obey their laws, and answers that are judged rightly."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from vidphys.experiments.core.bars import rows_of
from vidphys.experiments.filmed.laws.law import GRAVITY
from vidphys.experiments.recorded import table
from vidphys.experiments.recorded.cases import CASES
from vidphys.experiments.recorded.curves import BENT_TRAP, BOWL, SLACK
from vidphys.runs.records import Origin, Recorder

FINE = np.arange(4000) * 1e-3


def speeds(path):
    return np.linalg.norm(np.gradient(path, FINE, axis=0), axis=-1)[5:-5]


def test_a_bead_without_friction_keeps_its_energy_on_its_curve():
    path = BOWL.path(np.array([0.2, 0.3, 3.0, 0.0, 0.3]), FINE)[:, 0]
    np.testing.assert_allclose(path[:, 1], 0.2 * np.abs(path[:, 0] / 0.3) ** 3)
    energy = speeds(path) ** 2 / 2 + GRAVITY * path[5:-5, 1]
    np.testing.assert_allclose(energy, energy[0], rtol=2e-3)


def test_a_bent_trap_keeps_its_energy_without_friction():
    path = BENT_TRAP.path(np.array([5.0, 0.5, 0.0, 0.4]), FINE)[:, 0]
    energy = speeds(path) ** 2 / 2 + 5.0 / 1.5 * np.abs(path[5:-5, 0]) ** 1.5
    np.testing.assert_allclose(energy, energy[0], rtol=5e-3)


def test_a_slack_string_lets_its_weight_fall_and_is_never_longer():
    path = SLACK.path(np.array([0.4, 0.0, np.sqrt(3.5 * GRAVITY * 0.4)]), FINE)[:, 0]
    far = np.linalg.norm(path, axis=-1)
    assert far.max() < 0.4 * (1 + 1e-6)
    slack = far < 0.4 * (1 - 1e-3)
    assert 0.05 < slack.mean() < 0.9
    bend = np.diff(path, 2, axis=0)[slack[1:-1]] / 1e-6
    np.testing.assert_allclose(np.median(bend, axis=0), [0, -GRAVITY], atol=0.05)


@pytest.mark.parametrize("name", CASES)
def test_recordings_that_are_drawn_are_the_same_again(name):
    one, two = (CASES[name](np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one.motion.positions, two.motion.positions)
    assert np.isfinite(one.motion.positions).all() and one.numbers == two.numbers


@pytest.mark.parametrize(
    ("name", "terms", "exact"),
    [
        ("bounces", ["uniform", "wall"], True),
        ("bounces", ["uniform"], False),
        ("bob", ["pendulum"], False),
        ("bent-trap", ["formula", "linear"], True),
    ],
)
def test_an_answer_is_held_to_the_truth(monkeypatch, name, terms, exact):
    case = CASES[name](np.random.default_rng(0))
    said = {
        n: {"value": 1.02 * true, "standard_error": 0.005 * true}
        for n, true in case.numbers.items()
    }
    data = {"terms": terms, "status": "explained", "mechanism": [{"quantities": said}]}
    monkeypatch.setattr(table, "answer", lambda *_: SimpleNamespace(data=data))
    found = table.score(case)
    assert found.exact == exact and found.claimed
    assert all(x == pytest.approx(0.02) for x in found.errors.values())
    assert set(found.errors) == set(case.numbers) and not any(found.inside.values())


def test_every_bar_asks_for_what_its_cell_records():
    asked = {(row.cell, row.metric) for row in rows_of("recorded")}
    assert {cell for cell, _ in asked} == set(CASES)
    for cell, metric in asked:
        case = CASES[cell](np.random.default_rng(0))
        told = dict.fromkeys(case.numbers, 0.0), dict.fromkeys(case.numbers, True)
        names = dict.fromkeys((f.name for f in fields(Origin)), "none") | {"seed": 0}
        rows = Recorder(Origin(**names | {"context": None}))
        table._record(rows, [table.Score(case, (), table.EXPLAINED, True, *told)])
        assert metric in rows.tables()[0].column("metric").to_pylist()
