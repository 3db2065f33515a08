"""Diagnosis: terms and their numbers from exact and noisy tracks, and what must stay open."""

from dataclasses import replace

import numpy as np
import pytest

from vidphys.diagnose.diagnosis import diagnose_motion, nothing_to_see
from vidphys.diagnose.explanations.menu_model import specification
from vidphys.diagnose.explanations.specification import read_specification
from vidphys.diagnose.inference.changes import find_switch
from vidphys.diagnose.inference.linearised import fastest_rate
from vidphys.diagnose.inference.menu import FRICTIONS, external_terms, field_of
from vidphys.diagnose.inference.refine import refine
from vidphys.diagnose.inference.residual import _one_temperature
from vidphys.diagnose.inference.search import infer
from vidphys.diagnose.inference.structures import Structure
from vidphys.diagnose.recordings.identity import check_identity
from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.diagnose.recordings.noise import measure_noise
from vidphys.diagnose.telling.advice import suffices
from vidphys.diagnose.telling.answers import answer
from vidphys.diagnose.weak.paths import smooth
from vidphys.diagnose.weak.windows import cut_windows
from vidphys.errors import InputError
from vidphys.experiments.confusion.scenes import (
    KINDS,
    LINEAR,
    TRAP,
    Kind,
    Setting,
    attracted,
    drag,
    record,
    total,
    trapped,
)

STEP = 0.04


def seen(name, sigma=0.005, bodies=2, seed=0, clips=6, frames=48):
    return record(KINDS[name], Setting(sigma, STEP, bodies, seed), clips, frames)


# noise and windows


def test_noise_is_read_from_differences_of_smooth_motion():
    for sigma in (0.002, 0.02):
        assert measure_noise(seen("gravity", sigma)).sigma == pytest.approx(sigma, rel=0.06)
    assert measure_noise(seen("trap", 0.0)).sigma < 1e-6


def test_test_functions_see_accelerations_and_nothing_else():
    t = np.arange(12) * STEP
    rest, speed, pull = 3.0, -2.0, 0.7
    q = (rest + speed * t + 0.5 * pull * t**2)[None, :, None, None]
    windows = cut_windows(motion_of(q, STEP), 12)
    accelerations = np.full((1, len(windows.nodes), 1, 1), pull)
    np.testing.assert_allclose(windows.read(accelerations), windows.measured, atol=1e-12)
    assert np.abs(windows.measured).max() > 1e-3


def test_what_the_frames_cannot_tell_apart_has_no_small_error():
    windows = cut_windows(seen("trap-drag"), 12)
    paths = smooth(windows, 0.005)
    trap = next(term for term in external_terms(2, False) if term.kind == "trap")
    one = FRICTIONS["linear"]
    pull = np.array([TRAP, 0.0, 0.0])
    told = refine(windows, paths, Structure((trap, one), np.append(pull, 0.0), 0.0, 0.0))
    other = replace(one)  # the same columns again: only the sum of the two rates is seen
    both = Structure((trap, one, other), np.append(pull, [0.0, 0.0]), 0.0, 0.0)
    untold = refine(windows, paths, both)
    assert told.errors[3] < 0.1 * LINEAR
    assert untold.errors[3:].min() > 100 * LINEAR
    np.testing.assert_allclose(untold.errors[:3], told.errors[:3], rtol=0.1)
    assert untold.values[3:].sum() == pytest.approx(told.values[3], rel=1e-3)


def test_bodies_that_are_solved_for_one_by_one_keep_their_places_gaps_and_masses():
    t = STEP * np.arange(30)
    path = np.exp(-0.5 * t)[None, :, None, None] * np.arange(1.0, 7.0).reshape(1, 1, 3, 2)
    noise = 1e-3 * np.random.default_rng(0).standard_normal((2, *path.shape[1:]))
    path = path + noise
    path[1, 4:9, 1] = np.nan
    windows = cut_windows(motion_of(path, STEP, np.tile([1.0, 2.0, 4.0], (2, 1))), 15)
    friction = Structure((FRICTIONS["linear"],), np.zeros(1), 0.0, 0.0)
    found = refine(windows, smooth(windows, 1e-3), friction)
    at_frames = np.einsum("wfm,wmnd->wfnd", windows.to_frames, found.paths.q)
    seen_at = windows.seen[..., None]
    np.testing.assert_allclose(found.residual, (at_frames - windows.frames) * seen_at, atol=1e-12)
    rates = found.values[0] / windows.mass[:, None, :, None]
    np.testing.assert_allclose(found.paths.a, -rates * found.paths.v, atol=1e-9)


def test_test_functions_are_orthonormal_and_skip_frames_that_were_not_seen():
    q = np.random.default_rng(0).standard_normal((1, 10, 2, 1))
    q[0, 3, 0] = np.nan
    windows = cut_windows(motion_of(q, STEP), 10)
    rows = windows.tests[0][0]
    np.testing.assert_allclose(rows[1] @ rows[1].T, np.eye(8), atol=1e-12)
    assert np.abs(rows[0][:, 3]).max() == 0
    assert windows.informative[0].sum(-1).tolist() == [7, 8]


# numbers


@pytest.mark.parametrize("name", ["trap-drag", "gravity-drag", "drag"])
def test_exact_tracks_give_the_terms_and_their_numbers(name):
    found = infer(seen(name, 0.0))
    assert found.kinds == KINDS[name].truth
    fitted = found.fitted
    rate = fitted.values[fitted.place(found.structure.term("friction"))]
    assert rate == pytest.approx(LINEAR, rel=1e-3)
    if "trap" in found.kinds:
        assert fitted.values[0] == pytest.approx(TRAP, rel=1e-4)


def test_noise_does_not_pull_the_rate_towards_zero():
    rates = []
    for seed in range(4):
        fitted = infer(seen("trap-drag", 0.02, 3, seed)).fitted
        rates.append(fitted.values[fitted.place(fitted.structure.term("friction"))])
    assert np.mean(rates) == pytest.approx(LINEAR, rel=0.05)


@pytest.mark.slow
def test_intervals_hold_the_truth_about_as_often_as_they_say():
    held = []
    for seed in range(12):
        fitted = infer(seen("falling-drag", 0.01, 2, seed, 4, 32)).fitted
        at = fitted.place(fitted.structure.term("friction"))
        held.append(abs(fitted.values[at] - LINEAR) < 1.96 * fitted.errors[at])
    assert np.mean(held) >= 0.75


def test_a_clip_that_runs_backwards_has_the_negative_rate():
    motion = seen("trap-drag", 0.002, 2)
    found = [infer(m) for m in (motion, motion.reversed())]
    rates = [f.fitted.values[f.fitted.place(f.structure.term("friction"))] for f in found]
    assert rates[1] == pytest.approx(-rates[0], rel=1e-3)
    assert found[1].kinds == {"trap", "drive"}


# structure


@pytest.mark.parametrize("name", ["inertial", "projectile", "gravity", "trap-square", "disks-trap"])
def test_scenes_of_the_menu_are_told_apart(name):
    bodies = 3 if name == "disks-trap" else 2
    found = infer(seen(name, 0.005, bodies, 1, 8, 64))
    assert found.kinds == KINDS[name].truth
    assert found.leftover.explained


@pytest.fixture(scope="module")
def bathed():
    return infer(seen("langevin", 0.005, 3, 1, 8, 64))


def test_a_heat_bath_is_found_with_its_temperature(bathed):
    assert bathed.kinds == {"trap", "linear", "bath"} and bathed.leftover.explained
    assert bathed.kicks == pytest.approx(2 * 1.0 * 0.3, rel=0.25)


def test_a_friction_that_may_be_zero_is_not_named_for_the_kicks_it_came_with(bathed):
    vague = replace(bathed.fitted, covariance=1e6 * bathed.fitted.covariance)
    found = replace(bathed, fitted=vague)
    assert found.kinds == {"trap"}
    described = specification(found, STEP)
    assert list(described["terms"]["ports"]) == []
    assert all(name.startswith("trap") for name in described["numbers"])


def test_a_baths_friction_is_known_no_better_than_the_speeds_seen_allow(bathed):
    sure = replace(bathed.fitted, covariance=1e-6 * bathed.fitted.covariance)
    field = field_of(bathed.windows, sure.paths)
    brief = replace(bathed.windows, times=bathed.windows.times / 40)  # 1.5 speeds are forgotten
    assert _one_temperature(sure, bathed.kicks, field, bathed.windows)
    assert not _one_temperature(sure, bathed.kicks, field, brief)


def test_kicks_alone_are_no_heat_bath():
    found = infer(record(Kind("kicked", trapped, None, noise=0.5), Setting(0.005, STEP, 3, 1)))
    assert found.kicks == pytest.approx(0.5**2, rel=0.1)
    assert found.kinds == {"trap"} and not found.leftover.explained


@pytest.mark.parametrize("rate, explained", [(0.1, True), (0.4, False), (12.0, False)])
def test_a_bath_is_believed_only_where_speeds_last_for_some_frames(rate, explained):
    rate /= STEP
    bath = Kind("fast", total(trapped, drag(rate, 1)), None, noise=np.sqrt(2 * rate * 0.3))
    found = infer(record(bath, Setting(0.005, STEP, 1, 1), 16, 64))
    assert found.leftover.explained == explained
    assert ("record more often" in found.leftover.why) != explained


@pytest.mark.parametrize(
    "name", [pytest.param("outside-magnetic", marks=pytest.mark.slow), "outside-waning"]
)
def test_what_the_menu_lacks_is_said_to_be_unexplained(name):
    found = infer(seen(name, 0.005, 2, 1, 8, 64))
    assert not found.leftover.explained
    assert not found.sure


# abstention


def test_nothing_is_said_of_noise_rest_or_frames_out_of_order():
    rng = np.random.default_rng(0)
    moving = seen("trap").positions
    still = np.broadcast_to(moving[:, :1], moving.shape)
    for positions in (
        still,
        still + 0.005 * rng.standard_normal(moving.shape),
        rng.standard_normal(moving.shape),
        moving[:, rng.permutation(moving.shape[1])],
    ):
        assert diagnose_motion(motion_of(positions, STEP)).refused
    assert not nothing_to_see(seen("trap"))


@pytest.mark.parametrize("period, kinds", [(12, {"trap"}), (6, {"trap"}), (5, set())])
def test_a_swing_of_six_frames_and_more_is_seen(period, kinds):
    turn = 2 * np.pi * np.arange(64) / period
    path = np.stack([np.sin(turn), 0.5 * np.cos(turn)], -1)[None, :, None]
    noise = 0.01 * np.random.default_rng(0).standard_normal(path.shape)
    found = diagnose_motion(motion_of(path + noise, STEP))
    assert found.kinds == kinds and found.explained == bool(kinds)
    assert kinds or "six" in found.refused


def test_clips_put_out_of_order_together_are_one_accident():
    """Of one in a few such orders, many clips that share it seem to agree that they are smooth."""
    rng = np.random.default_rng(0)
    steady = np.linspace(0, 1, 64)[None, :, None, None] * rng.standard_normal((50, 1, 2, 2))
    for _ in range(30):
        assert nothing_to_see(motion_of(steady[:, rng.permutation(64)], STEP))
    assert not nothing_to_see(motion_of(steady, STEP))


@pytest.mark.parametrize("power", ["linear", pytest.param("even", marks=pytest.mark.slow)])
def test_the_sign_of_the_coupling_is_not_guessed_from_positive_ones(power):
    coupling = np.linspace(0.5, 1.5, 6)

    def recorded(values):
        strength = (values if power == "linear" else np.abs(values))[:, None, None]
        law = Kind("power", lambda q, v, t: strength * attracted(q, v, t), None)
        motion = record(law, Setting(0.003, STEP, 2, 3), 6, 48)
        return Motion(motion.positions, motion.times, motion.mass, values)

    open_question = diagnose_motion(recorded(coupling)).power
    assert {"linear", "even"} <= set(open_question.supported)
    assert open_question.query == pytest.approx(-1.0)
    both = coupling * np.array([1, -1, 1, -1, 1, -1])
    assert diagnose_motion(recorded(both)).power.supported == (power,)


# changes, masses, identity


def test_a_switch_is_found_near_its_frame_and_none_where_nothing_changes():
    damped = total(trapped, drag(1.5, 1))

    def law(q, v, t):
        return damped(q, v, t) if t >= 24 * STEP - 1e-9 else trapped(q, v, t)

    motion = record(Kind("switch", law, None), Setting(0.005, STEP, 2, 1), 6, 56)
    switch = find_switch(motion, infer(motion))
    assert switch is not None and abs(switch.frame - 24) <= 3
    before, after = (x["linear friction: rate"] for x in (switch.before, switch.after))
    assert abs(before) < 0.2 and after == pytest.approx(1.5, abs=0.3)
    same = seen("trap-drag", frames=56)
    assert find_switch(same, infer(same)) is None


@pytest.mark.parametrize("ratio, told", [(4.0, True), (1e3, False)])
def test_a_ratio_of_masses_shows_where_bodies_answer_differently(ratio, told):
    mass = np.array([1.0, ratio])[:, None]
    law = Kind("springs", lambda q, v, t: (4 * (q[:, ::-1] - q) - q) / mass, None)
    found = diagnose_motion(record(law, Setting(0.002, STEP, 2, 2), 6, 48))
    assert found.explained
    assert found.told == told and found.outweighed != told
    if told:
        assert found.motion.mass[0, 1] / found.motion.mass[0, 0] == pytest.approx(ratio, rel=0.005)


def test_swapped_names_show_as_jumps():
    motion = seen("trap", bodies=2)
    assert check_identity(motion).jumps == 0
    positions = motion.positions.copy()
    positions[0, 20:] = positions[0, 20:, ::-1]
    assert check_identity(motion_of(positions, STEP)).jumps > 0


# what follows from it


def test_advice_follows_the_stiffest_motion():
    found = infer(seen("trap", 0.001))
    advice = suffices(fastest_rate(found), STEP)
    assert advice.fastest == pytest.approx(TRAP**0.5, rel=0.02)
    assert advice.dt * advice.fastest == pytest.approx(0.1) and advice.enough_frames


def test_a_specification_builds_exactly_the_terms_that_were_found(tmp_path):
    from dynamics import build, terms
    from vidphys.runs.atomic import write_json

    found = infer(seen("falling-drag", 0.001))
    write_json(tmp_path / "s.json", specification(found, STEP))
    model, rest = read_specification(tmp_path / "s.json")
    assert {type(part) for part in model.parts()} == {
        *(terms.Hamiltonian, terms.Fixed, terms.Uniform, terms.Drag)
    }
    head = build(model, rest["bodies"], 0.01)
    assert {name.split(".")[0] for name, _ in head.named_parameters()} == {"potential", "ports"}
    assert rest["numbers"]["linear: rate"]["value"] == pytest.approx(LINEAR, rel=0.05)


def test_a_file_that_is_no_specification_is_refused(tmp_path):
    (tmp_path / "s.json").write_text("{}")
    with pytest.raises(InputError, match="not a scene specification"):
        read_specification(tmp_path / "s.json")


# what the integrals themselves are wrong by is no physics


def test_no_friction_is_read_from_what_the_integrals_are_wrong_by():
    found = infer(record(KINDS["gravity-field"], Setting(0.0, 0.08, 3, 102)))
    assert found.kinds == {"pair", "uniform"} and found.leftover.explained


def test_a_contact_that_frames_hardly_show_is_no_switch():
    seen_coarsely = record(KINDS["disks-trap"], Setting(0.0, 0.04, 2, 104))
    assert find_switch(seen_coarsely, infer(seen_coarsely)) is None


def test_rare_encounters_in_long_windows_are_no_kicks():
    found = infer(record(KINDS["repulsion"], Setting(0.02, 0.08, 5, 201), 4))
    assert found.kinds == {"pair"} and found.leftover.explained


def test_a_model_that_follows_only_for_a_while_is_said_to():
    t = np.arange(400) * STEP
    q, v, path = np.array([1.0, 0.0]), np.array([0.0, 0.6]), []
    for _ in t:  # about (x^4 + y^4) / 4, which no law has and a trap is like for a while
        path.append(q)
        for _ in range(20):
            v = v - 0.05 * STEP * q**3
            q = q + 0.05 * STEP * v
    noise = 0.003 * np.random.default_rng(0).standard_normal((len(t), 2))
    given = answer(motion_of((np.array(path) + noise)[None, :, None], STEP), False, 0.3)
    follows = given.data.get("follows_seconds")
    assert follows is not None and follows < 0.5 * t[-1] or not given.data["explained"]
    whole = answer(seen("trap", 0.003, 1, clips=1, frames=400), False, 0.3)
    assert whole.data["explained"] and "follows_seconds" not in whole.data
