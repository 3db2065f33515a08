"""The page gets what Python rolls, under the law, the start and the step that it asked."""

import json
from dataclasses import replace

import pytest
import torch
from torch import Generator

from dynamics import HEADS, INTEGRATORS, Parameters, PhaseState, build, rollout, terms
from dynamics.substeps import watched
from vidphys.errors import InputError
from vidphys.play import Asked, Stage, answers, source_of, stage, survey, surveys
from vidphys.play.pieces import in_pieces
from vidphys.play.rolling import Kept, begun, of_model
from vidphys.scenes import gravity

STEPS = 60


def a_stage(head="factored", episodes=10, **more):
    """An untrained model, beside an untrained twin and the truth."""
    torch.manual_seed(0)
    scene = gravity()
    learned, twin = (scene.build(HEADS[x]).requires_grad_(False) for x in (head, "unstructured"))
    twin.set_scale(1e-3, 1e-3)
    start, law = scene.sample(episodes, Generator().manual_seed(0))
    single = start.map(torch.Tensor.float), law.map(torch.Tensor.float)
    return Stage("it", learned, *single, scene.dt, scene, twin=(twin, scene.dt), **more)


def asked(**more):
    return Asked.read(json.dumps({"cell": "it", "steps": STEPS, **more}).encode())


def whole(stage, question, role):
    """All places of a role, ``(e, t, n, d)``, and what was said of its first piece."""
    pieces = [
        p
        for p in answers(stage, question)
        if p and p.about["role"] == role and p.places is not None
    ]
    begun = [piece.about["first"] for piece in pieces]
    ends = torch.tensor([p.places.shape[1] for p in pieces]).cumsum(0)
    assert begun == [0, *ends[:-1].tolist()]
    return torch.cat([piece.places for piece in pieces], 1), pieces[0].about


def test_the_model_is_rolled_as_python_does_under_the_law_that_is_asked():
    stage = a_stage()
    found, about = whole(stage, asked(coupling=-1.5), "model")
    law = stage.params.with_coupling(-1.5)
    path = rollout(stage.head, stage.start, law, STEPS, stage.dt)
    assert torch.allclose(found, path.states.q, atol=1e-6) and found.shape[1] == STEPS + 1
    held, _ = whole(stage, asked(), "model")
    assert not torch.allclose(found, held, atol=1e-4)
    assert about["bad"] == [-1] * 10 and about["steps"] == STEPS


def test_a_law_that_the_step_may_not_resolve_is_rolled_at_once_and_said():
    stage = a_stage().compiled()
    question = asked(factors={"mass1": 5.0, "mass2": 5.0}, coupling=50.0, dt=0.5)
    start, law, how = begun(stage, question)
    assert watched(law.head, start, law.params, how.dt)  # which rollout would take in pieces
    (piece,) = of_model(stage, law, start, how, question, Kept())
    assert piece.about["backend"] == "numba" and piece.about["said"]


def test_the_compiled_form_gives_the_same_to_its_tolerance():
    stage = a_stage().compiled()
    learned, compiled = stage.head, stage.quick
    assert compiled is not None and not stage.notes
    fast, about = whole(stage, asked(coupling=-1.0), "model")
    slow = rollout(learned, stage.start, stage.params.with_coupling(-1.0), STEPS, stage.dt)
    assert about["backend"] == "numba"
    assert torch.allclose(fast, slow.states.q, atol=1e-4)
    again = rollout(compiled, stage.start, stage.params.with_coupling(-1.0), STEPS, stage.dt)
    assert torch.equal(fast, again.states.q)


def test_a_compiled_form_is_left_for_an_integrator_that_it_does_not_have():
    stage = a_stage().compiled()
    _, about = whole(stage, asked(integrator="rk4"), "model")
    assert about["backend"] == "torch"
    _, about = whole(stage, asked(integrator="yoshida4"), "model")
    assert about["backend"] == "numba"


def test_friction_can_be_taken_from_a_pair_law_which_is_not_compiled_with_it():
    torch.manual_seed(0)
    term = replace(HEADS["factored-radial"], ports=(terms.LinearFriction(),))
    stage = replace(a_stage(), head=build(term, 3, 0.002).requires_grad_(False)).compiled()
    assert stage.quick is None and "with no ports" in stage.notes[0]
    free, _ = whole(stage, asked(factors={"friction": 0.0}), "model")
    rubbed, _ = whole(stage, asked(), "model")
    assert not torch.allclose(free, rubbed, atol=1e-5)


def test_the_truth_and_the_twin_stand_beside_it_under_the_same_law():
    stage = a_stage()
    truth, about = whole(stage, asked(coupling=-1.0, steps=50), "truth")
    double = stage.start.map(torch.Tensor.double), stage.params.map(torch.Tensor.double)
    real = stage.scene.simulate(double[0], double[1].with_coupling(-1.0), 50)
    assert torch.allclose(truth, real.states.q, atol=1e-9) and about["dt"] == stage.scene.dt
    twin, about = whole(stage, asked(coupling=-1.0, steps=50, episode=5), "twin")
    first = about["episode"]
    assert first <= 5 < first + len(twin)
    some = slice(first, first + len(twin))
    path = rollout(
        stage.twin[0], stage.start[some], stage.params[some].with_coupling(-1.0), 50, stage.dt
    )
    assert torch.allclose(twin, path.states.q, atol=1e-6)


def test_the_table_tells_how_far_each_episode_ends_from_the_truth():
    stage = a_stage()
    pieces = [piece for piece in answers(stage, asked()) if piece]
    table = next(piece for piece in pieces if piece.about["role"] == "table").about["rows"]
    mine, truth = (whole(stage, asked(), role)[0].double() for role in ("model", "truth"))
    apart = (mine - truth).norm(dim=-1).mean(-1)
    assert table["end"] == pytest.approx(apart[:, -1].tolist(), rel=1e-3)
    assert table["error"] == pytest.approx(apart.mean(1).tolist(), rel=1e-3)
    assert all(len(column) == stage.episodes for column in table.values())


def test_a_dragged_body_moves_one_episode_only():
    stage = a_stage()
    places = stage.start.q[3].tolist()
    places[1] = [2.0, -2.0]
    found, _ = whole(stage, asked(episode=3, q=places), "model")
    before, _ = whole(stage, asked(), "model")
    assert found[3, 0, 1].tolist() == [2.0, -2.0]
    others = [k for k in range(10) if k != 3]
    assert torch.equal(found[others], before[others])
    quick_body = [[0.0, 0.0], [5.0, 0.0], [0.0, 0.0]]
    found, _ = whole(stage, asked(episode=3, v=quick_body, coupling=0.0), "model")
    assert float(found[3, -1, 1, 0] - found[3, 0, 1, 0]) == pytest.approx(
        5.0 * STEPS * stage.dt, rel=1e-4
    )


def test_a_body_that_has_become_heavier_is_as_fast_as_it_was():
    stage = a_stage()
    found, _ = whole(stage, asked(factors={"mass2": 3.0}, coupling=0.0), "model")
    before, _ = whole(stage, asked(coupling=0.0), "model")
    assert torch.allclose(found, before, atol=1e-5)
    pulled, _ = whole(stage, asked(factors={"mass2": 3.0}), "model")
    assert not torch.allclose(pulled, whole(stage, asked(), "model")[0], atol=1e-5)


@pytest.mark.parametrize(
    "name",
    [
        "yoshida4",
        pytest.param("rk4", marks=pytest.mark.slow),
        pytest.param("kahan_li8", marks=pytest.mark.slow),
        "implicit_midpoint",
    ],
)
def test_the_integrator_and_the_step_are_those_that_are_asked(name):
    stage = a_stage()
    found, about = whole(stage, asked(integrator=name, dt=0.004, steps=20), "model")
    head = stage.head
    own, head.integrator = head.integrator, INTEGRATORS[name]
    path = rollout(head, stage.start, stage.params, 20, 0.004)
    head.integrator = own
    assert torch.allclose(found, path.states.q, atol=1e-6)
    assert about["dt"] == pytest.approx(0.004)


def test_what_is_not_finite_stays_behind_and_the_others_go_on():
    stage = a_stage()

    def roll(state, params, count, every):
        assert torch.isfinite(state.q).all()  # a rollout would refuse it
        found = rollout(stage.head, state, params, count, stage.dt, every)
        if len(state.q) == 10:
            found.states.q[4, -1] = torch.nan
        return found

    pieces = [found for _, found in in_pieces(roll, stage.start, stage.params, STEPS, 1)]
    assert len(pieces) > 1
    assert pieces[0].first_bad.tolist() == [-1] * 4 + [pieces[0].states.q.shape[1] - 1] + [-1] * 5
    found = torch.cat([piece.states.q for piece in pieces], 1)
    others = [k for k in range(10) if k != 4]
    plain = rollout(stage.head, stage.start, stage.params, STEPS, stage.dt).states.q
    assert torch.allclose(found[others], plain[others], atol=1e-6)
    assert torch.isnan(pieces[1].states.q[4]).all()


def test_a_law_that_changes_with_time_goes_on_from_piece_to_piece():
    swing = terms.Hamiltonian(potentials=(terms.Trap(4.0),))
    motor = terms.Sinusoid((2.0,), (0.5,), 3.1)
    head = build(terms.Clocked(swing, (motor,)), 1, 0.01, 1)
    start = PhaseState(torch.ones(2, 1, 1), torch.zeros(2, 1, 1))
    law = Parameters(torch.ones(2), torch.ones(2, 1)).with_scalar("clock", 0.3)

    def roll(state, params, count, every):
        return rollout(head, state, params, count, 0.01, every)

    pieces = [found for found in in_pieces(roll, start, law, 300, 25) if found]
    assert len(pieces) > 1
    q = torch.cat([piece.states.q for _, piece in pieces], 1)
    assert torch.allclose(q, rollout(head, start, law, 300, 0.01, 25).states.q, atol=1e-5)


@pytest.mark.parametrize(
    ("seconds_a_step", "of_checks", "longest", "most"),
    [(1e-4, 0, 80, 6), (1e-2, 0, 4, 200), (1e-4, 0.05, 5, 41)],
)
def test_a_piece_is_short_where_steps_are_slow_and_long_enough_for_its_checks_where_they_are_not(
    monkeypatch, seconds_a_step, of_checks, longest, most
):
    """A change waits for a piece; a piece of 200 steps repeats the checks of all of them."""
    stage, clock = a_stage(), [0.0]

    def roll(state, params, count, every):
        clock[0] += of_checks + seconds_a_step * count
        return rollout(stage.head, state, params, count, stage.dt, every)

    monkeypatch.setattr("vidphys.play.pieces.time.perf_counter", lambda: clock[0])
    found = in_pieces(roll, stage.start, stage.params, 200, 1)
    sizes = [found.states.q.shape[1] - (first == 0) for first, found in found]
    assert sum(sizes) == 200 and max(sizes) == longest and most * 0.8 < len(sizes) <= most


def test_a_change_need_not_wait_for_the_next_stored_state_where_steps_are_slow(monkeypatch):
    stage, clock = a_stage(), [0.0]

    def roll(state, params, count, every):
        clock[0] += 0.02 * count
        found = rollout(stage.head, state, params, count, stage.dt, every)
        if clock[0] > 1.51 and len(state.q) == 10:
            found.states.q[4] = torch.nan  # between two that are stored
        return found

    monkeypatch.setattr("vidphys.play.pieces.time.perf_counter", lambda: clock[0])
    found = list(in_pieces(roll, stage.start, stage.params, 200, 25))
    some = [part for part in found if part]
    assert len(found) > 180 and [first for first, _ in some] == [0, *range(2, 9)]
    assert {part.dt for _, part in some} == {25 * stage.dt}
    q = torch.cat([part.states.q for _, part in some], 1)
    plain = rollout(stage.head, stage.start, stage.params, 200, stage.dt, 25).states.q
    others = [k for k in range(10) if k != 4]
    assert torch.equal(q[others], plain[others])
    assert torch.isfinite(q[4]).flatten(1).all(1).tolist() == [True] * 4 + [False] * 5
    assert [part.first_bad[4].item() for _, part in some] == [-1, -1, -1] + [0] * 5


def test_states_far_from_training_are_marked():
    stage = a_stage()
    stage.head.domain.copy_(torch.tensor([9.0, 9.0, 9.0, 500.0]))
    away = [[100.0, 0.0], *stage.start.q[2, 1:].tolist()]
    _, about = whole(stage, asked(episode=2, q=away), "model")
    assert about["left"][2] == 0 and about["left"].count(-1) == 9
    assert "more than 3 times" in " ".join(about["said"])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"episode": 10}, "episode 10: there are 10"),
        ({"integrator": "euler"}, "integrator euler: this model has leapfrog"),
        ({"factors": {"mass1": 99.0}}, "mass1 99: a factor from 0.2 to 5"),
        ({"factors": {"friction": 2.0}}, "no such number"),
        ({"q": [[0.0, 0.0]]}, "q: needs 3 bodies of 2 numbers"),
        ({"steps": 0}, "steps 0"),
        ({"coupling": 1e99}, "coupling 1e"),
        ({"G": 1.0}, "G"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_line(wrong, said):
    with pytest.raises(InputError, match=said) as refused:
        list(answers(a_stage(), asked(**wrong)))
    assert "\n" not in str(refused.value)


def test_of_many_episodes_those_beside_one_are_rolled_and_all_are_surveyed(monkeypatch):
    monkeypatch.setattr(stage, "AT_ONCE", 4)
    monkeypatch.setattr(surveys, "BATCH", 3)
    many, law = a_stage(), {"coupling": -1.0}
    found, about = whole(many, asked(episode=9, **law), "model")
    path = rollout(many.head, many.start, many.params.with_coupling(-1.0), STEPS, many.dt)
    assert about["episode"] == 8 and torch.allclose(found, path.states.q[8:], atol=1e-6)
    tables = [
        p.about
        for p in survey(many, asked(episode=9, q=[[0.0, 1.0]] * 3, **law))
        if p and p.about["role"] == "table"
    ]
    assert [table["episode"] for table in tables] == [0, 3, 6, 9]
    for first in (0, 4, 8):
        pieces = answers(many, asked(episode=first, **law))
        rows = next(p.about["rows"] for p in pieces if p and p.about["role"] == "table")
        for name in ("error", "end", "drift", "closest", "coupling"):
            every = [x for table in tables for x in table["rows"][name]]
            assert every[first : first + 4] == pytest.approx(rows[name], rel=1e-4, abs=1e-6)


def test_a_map_keeps_its_step_and_has_no_integrators():
    stage = a_stage("unstructured")
    assert stage.integrators == [] and stage.told()["fixed_step"]
    with pytest.raises(InputError, match="a map of"):
        list(answers(stage, asked(dt=0.01)))


def test_a_scene_is_a_stage_by_its_name():
    stage = source_of("springs").stage("springs")
    told = stage.told()
    assert told["episodes"] == 64 and told["truth"] and not told["twin"]
    json.dumps(told, allow_nan=False)
    with pytest.raises(InputError, match="did you mean the scene gravity"):
        source_of("gravty")
