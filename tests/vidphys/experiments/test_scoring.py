"""Questions: from another start it is the same question, and the truth is asked once."""

import dataclasses

import pytest
import torch

from dynamics import HEADS, PhaseState
from dynamics.compiled import choice
from vidphys import metrics
from vidphys.experiments.core import scoring
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.oracle import held_out_question
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_drift, score_inversion, score_long_drift
from vidphys.runs.records import Origin, Recorder
from vidphys.scenes import gravity


def test_another_start_shares_what_the_truth_answers_and_changes_nothing_of_it(monkeypatch):
    scene = gravity()
    truth, params = scene.sample(2, torch.Generator().manual_seed(0))
    asked = Question(scene, truth, truth, params, steps=20)
    rolled = []
    simulate = type(scene).simulate

    def counted(*arguments, **named):
        rolled.append(arguments)
        return simulate(*arguments, **named)

    monkeypatch.setattr(type(scene), "simulate", counted)
    moved = asked.starting(truth.map(lambda x: x + 0.1))
    flipped = params.with_coupling(-1.0)
    first = asked.reference(flipped)
    assert moved.reference(flipped) is first and len(rolled) == 1
    assert moved.truth is truth and not torch.equal(moved.start.q, truth.q)
    torch.testing.assert_close(first.states.q[:, 0], truth.q)
    # another law, and the same question asked over another time, are rolled anew
    assert not torch.equal(moved.reference(params).states.q, first.states.q)
    longer = dataclasses.replace(asked, steps=40).reference(flipped)
    assert len(rolled) == 3 and longer.states.q.shape[1] == 9
    # and so are other moments of it, and another scene's answer from the same start
    assert dataclasses.replace(asked, every=10).reference(flipped).states.q.shape[1] == 3
    finer = dataclasses.replace(scene, dt=scene.dt / 2)
    assert dataclasses.replace(asked, scene=finer).reference(flipped).dt < first.dt
    assert len(rolled) == 5


def test_one_episode_alone_is_the_question_of_it_and_shares_the_truth():
    scene = gravity()
    truth, params = scene.sample(3, torch.Generator().manual_seed(0))
    asked = Question(scene, truth.map(lambda x: x + 0.1), truth, params, steps=20)
    one = asked.alone(1, 40)
    torch.testing.assert_close(one.start.q, asked.start.q[1:2])
    torch.testing.assert_close(one.params.mass, params.mass[1:2])
    found = one.reference(one.params).states.q
    torch.testing.assert_close(found[:, :5], asked.reference(params).states.q[1:2])
    assert found.shape[1] == 9
    assert asked.starting(truth).alone(1, 40).reference(one.params).states.q is found


def new_recorder():
    return Recorder(Origin(*"abcdefgh", seed=0, device="cpu", dtype="float32"))


def test_a_longer_rollout_that_is_there_gives_the_same_numbers(monkeypatch):
    scene = gravity()
    start, params = scene.sample(8, torch.Generator().manual_seed(0))
    asked = Question(scene, start, start, params, steps=20)
    torch.manual_seed(0)
    head, ask = scene.build(HEADS["factored"]), Question.ask
    monkeypatch.setattr(scoring, "LONG_STEPS", 200)
    tables, asks = [], []
    for rolled in (None, asked.ask(head, 200)):
        recorder, calls = new_recorder(), []
        monkeypatch.setattr(Question, "ask", lambda *a, calls=calls: calls.append(a) or ask(*a))
        score_inversion(recorder, head, asked, rolled)
        score_drift(recorder, head, asked, (20, 100), rolled)
        score_long_drift(recorder, head, asked, rolled)
        tables.append(recorder.tables())
        asks.append(len(calls))
    assert asks[0] == asks[1] + 3
    for kind in (0, 1):
        assert tables[0][kind].equals(tables[1][kind])


@pytest.mark.parametrize("name", ["factored", "factored-radial"])
def test_a_spline_answers_as_its_network_and_the_record_says_which_did(name, monkeypatch):
    scene = gravity()
    start, params = scene.sample(8, torch.Generator().manual_seed(0))
    asked = Question(scene, start, start, params, steps=100)
    torch.manual_seed(0)
    head = scene.build(HEADS[name])
    with torch.no_grad():
        head.potential.phi.layers[-1].weight *= 8  # forces of order one
    found = {}
    for form, pays in (("network", choice.PAYS), ("spline", 1)):
        monkeypatch.setattr(choice, "PAYS", pays)
        recorder = new_recorder()
        score_inversion(recorder, head, asked)
        score_drift(recorder, head, asked, (100, 200))
        rows = recorder.rows
        found[form] = {(r["metric"], r["coupling"], r["horizon"]): r["value"] for r in rows}
    network, spline = found["network"], found["spline"]
    for law, steps in ((-0.5, 100), (-1.0, 100), (-1.5, 100), (None, 200)):
        assert (network["compiled", law, steps], spline["compiled", law, steps]) == (0, 1)
        assert 0 < spline["compiled_force_error", law, steps] <= choice.TOLERANCE
        assert spline["compiled_tolerance", law, steps] == choice.TOLERANCE
    assert not [key for key in network if key[0].startswith("compiled_")]
    for key, value in network.items():
        if value is None:
            assert spline[key] is None, key
        elif key[0] != "compiled":
            near = pytest.approx(value, rel=20 * choice.TOLERANCE, abs=choice.TOLERANCE)
            assert spline[key] == near, key


def test_a_model_that_is_read_back_is_rolled_to_the_same_bits(monkeypatch):
    scene = gravity()
    start, params = scene.sample(8, torch.Generator().manual_seed(0))
    asked = Question(scene, start, start, params, steps=20)
    monkeypatch.setattr(choice, "PAYS", 1)
    heads = [scene.build(HEADS["factored"]) for _ in range(2)]
    heads[1].load_state_dict(heads[0].state_dict())
    one, two = (asked.ask(head, 100) for head in heads)
    assert one.report is not None and one.report == two.report
    assert torch.equal(one.states.flat, two.states.flat)


@pytest.mark.parametrize(("sound", "status"), [(1, "failed"), (2, "ok")])
def test_a_slope_needs_two_episodes_that_are_finite(sound, status):
    scene = gravity()
    start, params = scene.sample(4, torch.Generator().manual_seed(0))
    asked, recorder = Question(scene, start, start, params, steps=20), new_recorder()
    rolled = asked.ask(scene.law, 40)
    rolled.states.p[sound:] = torch.nan
    score_long_drift(recorder, scene.law, asked, rolled)
    (row,) = [row for row in recorder.rows if row["metric"] == "energy_drift_slope"]
    assert (row["status"], row["episodes"], row["nonfinite"]) == (status, 4, 4 - sound)


def test_valid_time_ends_at_the_first_error_and_not_at_a_later_one():
    truth = PhaseState(*2 * [torch.linspace(0, 4, 9).reshape(1, 9, 1, 1).expand(3, 9, 1, 1)])
    q = truth.q.clone()
    q[0, 4] += 10  # wrong once, right again
    q[1, 0] = torch.nan  # never right
    found = metrics.valid_time(PhaseState(q, truth.p), truth, interval=0.25)
    assert found.tolist() == [0.75, 0.0, 2.0]


def test_the_true_law_is_valid_to_the_end_and_finds_its_way_back():
    scene = gravity()
    question = held_out_question(scene, 4, 0)
    recorder = Recorder(Origin(*"abcdefgh", seed=0, device="cpu", dtype="float64"))
    score_drift(recorder, scene.law, question, (100,))
    score_retrace(recorder, scene.law, question)
    found = {row["metric"]: row["value"] for row in recorder.rows}
    assert found["valid_time"] == pytest.approx(100 * scene.dt)
    assert found["retrace_nmse"] < 1e-15
