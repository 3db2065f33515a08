"""What trackers do wrong: found, mended, weighed, and never believed."""

from dataclasses import replace

import numpy as np
import pytest

from vidphys.diagnose.diagnosis import Diagnosis, diagnose_motion
from vidphys.diagnose.inference.doubts import doubts
from vidphys.diagnose.inference.measured import remeasured
from vidphys.diagnose.inference.probes import _turned, _uneven
from vidphys.diagnose.inference.search import infer
from vidphys.diagnose.recordings.colour import Colour
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.weak.colour import colour_of
from vidphys.diagnose.weak.mending import mend
from vidphys.diagnose.weak.windows import cut_windows
from vidphys.experiments.confusion.scenes import KINDS, Kind, Setting, path_of, total, trapped
from vidphys.experiments.confusion.scores import Answer
from vidphys.experiments.confusion.storms import forces
from vidphys.experiments.confusion.storms.measured import MEASURES, gaps, remembering, swaps
from vidphys.experiments.confusion.storms.scenes import LISTED, filmed
from vidphys.experiments.confusion.storms.scores import Scored, scores
from vidphys.experiments.confusion.storms.table import measures_of
from vidphys.experiments.confusion.storms.unlisted import UNLISTED

STEP, SIGMA = 0.04, 0.005


def paths(name, bodies=2, seed=1):
    return path_of(KINDS[name], Setting(0.0, STEP, bodies, seed))


def measured(name, measure, bodies=2, seed=1):
    rng = np.random.default_rng(seed)
    return motion_of(MEASURES[measure](paths(name, bodies, seed), SIGMA, rng), STEP)


# mending


@pytest.mark.parametrize("name", ["trap", "gravity", "disks-trap", "langevin"])
def test_tracks_with_nothing_wrong_are_left_alone(name):
    motion = measured(name, "white", 3)
    assert mend(motion).motion is motion


def test_false_finds_become_gaps_and_true_frames_stay():
    path = paths("trap", 3)
    rng = np.random.default_rng(2)
    motion = motion_of(MEASURES["outliers"](path, SIGMA, rng), STEP)
    off = np.linalg.norm(motion.positions - path, axis=-1)
    gone = ~mend(motion).motion.seen
    assert (off > 0.2).sum() > 20
    assert gone[off > 0.2].mean() >= 0.95
    assert gone[off < 4 * SIGMA].mean() <= 0.01


def test_swapped_names_go_back():
    path = paths("trap", 3, 4)
    rng = np.random.default_rng(3)
    white = path + SIGMA * rng.standard_normal(path.shape)
    mixed = swaps(white, rng)
    assert np.abs(mixed - white).max() > 0.5
    found = mend(motion_of(mixed, STEP))
    assert found.swaps > 0
    for clip in range(len(path)):
        # A clip may keep other names from its first frame on; no body changes its own within.
        away = np.linalg.norm(found.motion.positions[clip] - path[clip], axis=-1)
        assert (away < 0.1).mean() > 0.95


@pytest.mark.parametrize("seed", [1, 2])
def test_names_go_back_where_false_finds_and_gaps_lie_beside(seed):
    path = paths("trap", 3, seed)
    rng = np.random.default_rng(seed)
    motion = mend(motion_of(MEASURES["all"](path, SIGMA, rng), STEP)).motion
    away = np.linalg.norm(motion.positions[:, :, :, None] - path[:, :, None], axis=-1)
    nearest, name = np.sort(away, -1), away.argmin(-1)
    assert (nearest[motion.seen][:, 0] > 8 * SIGMA).mean() < 0.001
    apart = motion.seen & (nearest[..., 1] > 0.1)
    own = np.ma.masked_array(name, ~apart)
    assert (own == np.ma.median(own, axis=1, keepdims=True)).mean() > 0.98
    assert motion.seen.mean() > 0.8


def test_what_was_mended_and_what_stays_open_is_said():
    found = diagnose_motion(measured("trap", "outliers"))
    assert found.told and "frames of a body fit none" in found.mended.said[0]
    inference = found.inference
    assert not doubts(found.motion, inference)
    uneven = replace(inference, leftover=replace(inference.leftover, uneven=1e-9))
    assert not uneven.sure and "swapped names" in doubts(found.motion, uneven)[0]
    lacking = replace(inference.leftover, explained=False, probes={"a force": 1e3})
    assert lacking.certain and not replace(lacking, uneven=1e-9).certain
    unknown = replace(inference.leftover, explained=False)
    assert "give the masses" in doubts(found.motion, replace(inference, leftover=unknown))[0]


# colour


def test_a_memory_of_the_noise_is_told_from_white_noise_and_from_kicks():
    rng = np.random.default_rng(0)
    still = np.zeros((8, 64, 3, 2))
    kicked = (0.02 * rng.standard_normal(still.shape)).cumsum(1).cumsum(1) * STEP
    white = SIGMA * rng.standard_normal(still.shape)
    windows = cut_windows(motion_of(still, STEP), 32)

    def found(error):
        return colour_of(windows, cut_windows(motion_of(error, STEP), 32).frames)

    assert found(white) is None
    assert found(white + kicked) is None
    lasting = found(remembering(still, SIGMA, rng))
    assert np.exp(-STEP / lasting.memory) == pytest.approx(0.8, abs=0.1)
    assert lasting.sigma == pytest.approx(SIGMA, rel=0.35)


def test_rows_of_coloured_noise_are_white_and_of_unit_size():
    rng = np.random.default_rng(0)
    noise = gaps(remembering(np.zeros((400, 16, 1, 2)), 1.0, rng), rng)
    motion = motion_of(noise, STEP)
    motion = replace(motion, colour=Colour(1.0, -STEP / np.log(0.8)))
    windows = cut_windows(motion, 16)
    rows = windows.measured[windows.informative]
    assert rows.var() == pytest.approx(1.0, rel=0.05)
    white = windows.whitening() @ windows.frames.transpose(0, 2, 1, 3)
    assert white[:, 0, 5:].var() == pytest.approx(windows.seen[:, 5:].mean(), rel=0.06)


@pytest.mark.slow
def test_noise_with_a_memory_is_neither_a_bath_nor_a_force():
    for name in ("projectile", "trap-drive"):
        found = diagnose_motion(measured(name, "ar1"))
        assert found.kinds == KINDS[name].truth and found.explained
        assert found.motion.colour is not None
    bath = diagnose_motion(measured("langevin", "white", 3))
    assert bath.motion.colour is None and "bath" in bath.kinds


@pytest.mark.parametrize("measure, size, there", [("ar1", 1, True), ("white", 30, False)])
def test_what_a_law_leaves_is_noise_only_where_the_frames_bear_it_out(
    measure, size, there, monkeypatch
):
    motion = measured("trap", measure)
    windows = cut_windows(motion, 16)
    rng = np.random.default_rng(0)
    left = windows, remembering(np.zeros_like(windows.frames), size * SIGMA, rng)
    assert colour_of(*left) is not None
    monkeypatch.setattr("vidphys.diagnose.inference.measured._residual", lambda *_: left)
    assert (remeasured(motion, infer(motion)) is not None) == there


# masses that nobody told


@pytest.mark.parametrize(
    "ratio, measure", [(1.3, "white"), pytest.param(4.0, "ar1", marks=pytest.mark.slow)]
)
def test_masses_that_nobody_told_are_found_also_between_those_first_tried(ratio, measure):
    mass = np.array([1.0, ratio]) / np.sqrt(ratio)
    law = Kind("held", lambda q, v, t: 1.5 * trapped(q, v, t) / mass[:, None], None)
    path = path_of(law, Setting(0.0, STEP, 2, 1))
    rng = np.random.default_rng(0)
    found = diagnose_motion(motion_of(MEASURES[measure](path, SIGMA, rng), STEP))
    assert found.kinds == {"trap"} and found.explained
    told = found.motion.mass[0]
    assert told[1] / told[0] == pytest.approx(ratio, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("space, seed", [(1, 1000), (2, 1003)])
def test_bodies_that_air_slows_differently_have_other_masses_not_more_forces(space, seed):
    """As two bodies of one mass they would show a pair force, and another friction."""
    rng = np.random.default_rng(seed)
    place, speed = rng.standard_normal((2, 1, 2, space))
    rates, times = np.array([[0.1], [0.6]]), np.linspace(0.0, 3.0, 120)
    path = place + speed / rates * -np.expm1(-rates * times[:, None, None])
    path += 0.002 * rng.standard_normal(path.shape)
    found = diagnose_motion(motion_of(path[None], times[1]))
    assert found.kinds == {"linear"} and found.sure and found.weighed
    told = found.motion.mass[0]
    assert told[0] / told[1] == pytest.approx(6.0, rel=0.05)


# terms that stand together


@pytest.mark.parametrize("other, power", [("dry", 0), ("square", 2)])
def test_two_frictions_at_once_are_both_found(other, power):
    resisted = [forces.resisted(0.4, 1), forces.resisted(0.4, power)]
    law = Kind(
        "two", lambda q, v, t: trapped(q, v, t) + sum(f(q, v, t) for f in resisted), None, speed=1.2
    )
    path = path_of(law, Setting(0.0, STEP, 2, 1))
    noise = 0.001 * np.random.default_rng(0).standard_normal(path.shape)
    found = infer(motion_of(path + noise, STEP))
    assert found.kinds == {"trap", "linear", other} and found.leftover.explained
    rates = found.fitted.values[-2:]
    np.testing.assert_allclose(rates, 0.4, rtol=0.1)


def test_kicks_move_heavy_bodies_less():
    windows = cut_windows(motion_of(np.zeros((1, 12, 2, 1)), STEP, np.array([[1.0, 2.0]])), 12)
    light, heavy = windows.tests[1][0]
    np.testing.assert_allclose(light, 4 * heavy)
    assert not np.allclose(*windows.whitening(1e3)[0])
    np.testing.assert_allclose(*windows.whitening(0.0)[0])


# what the menu lacks


INVERSE_SQUARE = forces.powered(1.0, 0.3, 2.0)
OPPOSITES = np.array([[0.0, 1.0, -1.0], [1.0, 0.0, -1.0], [-1.0, -1.0, 0.0]])
WANING = forces.varying(forces.between(INVERSE_SQUARE), 0.3)
SHOVED = forces.pushed(np.array([1.0, 0.5]), 1.0, 0.4)


@pytest.mark.parametrize(
    "law, lacking",
    [
        (forces.between(forces.powered(2.0, 0.3, 1.5)), ""),
        (forces.three_together(1.0), "pair forces that depend on who else is near"),
        (forces.between(INVERSE_SQUARE, OPPOSITES), "pairs that differ"),
        pytest.param(
            total(forces.held(1.5, (0.1, 0.0)), SHOVED),
            "a push that changes with time",
            marks=pytest.mark.slow,
        ),
        (WANING, "strengths that change slowly with time"),
        pytest.param(forces.following(0.3, 1.0), "friction between bodies", marks=pytest.mark.slow),
    ],
)
def test_a_force_that_the_menu_lacks_is_called_by_what_it_does(law, lacking):
    path = path_of(Kind("law", law, None), Setting(0.0, STEP, 3, 1))
    noise = 0.001 * np.random.default_rng(0).standard_normal(path.shape)
    rest = infer(motion_of(path + noise, STEP)).leftover
    assert max(rest.probes, key=rest.probes.get, default="") == lacking
    assert lacking or not rest.certain


def test_a_force_that_would_not_show_leaves_the_answer_unsure():
    path = paths("drag", 1, 0)
    noise = np.random.default_rng(0).standard_normal(path.shape)
    clear, dim = (infer(motion_of(path + size * noise, STEP)) for size in (0.001, 0.04))
    assert clear.kinds == dim.kinds == {"linear"} and clear.stands and dim.stands
    assert clear.sure and not clear.leftover.unseen and not dim.sure
    for name, size in clear.leftover.hidden.items():
        assert dim.leftover.hidden[name] == pytest.approx(40 * size, rel=0.1)
    assert "would not show" in doubts(motion_of(path, STEP), dim)[0]


def test_a_force_that_the_menu_lacks_is_asked_for_also_where_no_other_is_found():
    """Bodies that nearly go straight on: what tells them from free ones, or hides it."""
    noise = 0.002 * np.random.default_rng(0).standard_normal((8, 64, 2, 2))
    slight, free = forces.following(0.02, 1.0), forces.following(0.0, 1.0)
    found = {}
    for law in (slight, free):
        path = path_of(Kind("law", law, None, speed=0.7), Setting(0.0, STEP, 2, 1))
        found[law] = infer(motion_of(path + noise, STEP))
        assert not found[law].kinds
    assert found[slight].leftover.probes.keys() == {"friction between bodies"}
    assert found[free].sure and not found[free].leftover.unseen
    assert 0 < max(found[free].leftover.hidden.values()) < 0.04


def test_what_acts_faster_than_frames_follow_is_not_told_to_be_off_the_menu():
    motion = measured("trap", "white", 1)
    found = infer(motion)
    lacking = replace(found.leftover, explained=False, probes={"a force": 1e3})
    found = replace(found, leftover=lacking)
    seldom = replace(found, windows=replace(found.windows, times=50 * found.windows.times))
    told, untold = (Diagnosis(motion, x.noise, "", x) for x in (found, seldom))
    assert told.told and not doubts(motion, found)
    assert not untold.told and "more often" in doubts(motion, seldom)[0]


# the scenes and their scores


def test_scenes_are_drawn_anew_for_each_seed_and_alike_for_the_same():
    some = LISTED["gravity"]
    first, again, other = (filmed(some, "all", seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.motion.positions, again.motion.positions)
    assert first.motion.positions.shape != other.motion.positions.shape or not np.allclose(
        first.motion.positions, other.motion.positions, equal_nan=True
    )
    hidden = filmed(LISTED["outside-hidden"], "white", 0)
    assert hidden.motion.bodies == hidden.bodies


def test_three_bodies_together_feel_no_pair():
    law = forces.three_together(1.0)
    two = np.array([[[0.0, 0.0], [0.5, 0.0]]])
    assert not law(two, two, 0.0).any()
    three = np.concatenate([two, [[[0.0, 0.5]]]], 1)
    assert law(three, three, 0.0).any()


def test_no_class_is_both_tuned_on_and_held_out():
    assert not set(LISTED) & set(UNLISTED)
    assert all(some.truth is None for some in UNLISTED.values())


def test_a_small_preset_takes_turns_over_measures_and_a_large_one_has_all():
    quick = [measures_of(number, 32, 0) for number in range(7)]
    assert all(len(set(some)) == 2 for some in quick)
    assert {name for some in quick for name in some} == set(MEASURES)
    assert set(measures_of(3, 64, 0)) == set(MEASURES)


def test_what_is_said_surely_and_is_wrong_counts_a_false_alarm_too():
    trap, magnetic = frozenset({"trap"}), None
    marked = [
        Scored("trap", trap, Answer(trap)),
        Scored("trap", trap, Answer(frozenset({"pair"}))),
        Scored("trap", trap, Answer(frozenset({"pair"}), sure=False)),
        Scored("trap", trap, Answer(trap, explained=False)),
        Scored("magnetic", magnetic, Answer(trap)),
        Scored("magnetic", magnetic, Answer(trap, explained=False)),
    ]
    found = scores(marked)
    assert found["exact_structure"] == [True, False, False, False, False, True]
    assert found["sure_and_wrong"] == [False, True, False, True, True, False]
    assert found["not_told"] == [False, False, True, False, False, False]


def test_bodies_in_space_are_asked_for_what_the_menu_lacks():
    start, t = np.random.default_rng(1).standard_normal((2, 3)), 0.025 * np.arange(84)
    path = start / 0.5 * (1 - np.exp(-0.5 * t))[:, None, None]
    noise = 0.002 * np.random.default_rng(0).standard_normal(path.shape)
    found = infer(motion_of((path + noise)[None], 0.025))
    assert found.kinds == {"linear"} and found.leftover.explained
    assert "a force across the velocity" in found.leftover.hidden


@pytest.mark.parametrize("space", [2, 3])
def test_what_is_turned_stands_across_and_what_is_uneven_has_no_part_that_is_even(space):
    x = np.random.default_rng(0).standard_normal((5, space))
    across, uneven = _turned(x), _uneven(x)
    assert across.shape[-1] == space * (space - 1) // 2
    np.testing.assert_allclose((x[..., None] * across).sum(-2), 0, atol=1e-12)
    axes = _uneven(np.eye(space))  # a matrix for each column
    assert uneven.shape[-1] == np.linalg.matrix_rank(axes.reshape(-1, axes.shape[-1]))
    np.testing.assert_allclose(axes, axes.swapaxes(0, 1))
    np.testing.assert_allclose(np.trace(axes), 0)


def test_no_frame_of_a_fast_body_is_a_false_find_beside_slow_ones():
    turned = np.arange(200)[:, None] * np.array([0.15, 0.02, 0.015, 0.01])
    path = np.stack([np.cos(turned) + 0.3 * np.cos(2 * turned), np.sin(turned)], -1)[None]
    exact = path + 1e-5 * np.random.default_rng(0).standard_normal(path.shape)
    assert mend(motion_of(exact, 0.02)).false_finds == 0
    exact[0, [40, 120], 3] += 0.3
    assert mend(motion_of(exact, 0.02)).false_finds == 2
