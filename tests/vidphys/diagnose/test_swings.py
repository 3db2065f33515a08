"""What swings on a line, and what on an arc, before a camera that does not face it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dynamics import from_config
from dynamics.terms import Spring
from vidphys.diagnose.explanations import rivals
from vidphys.diagnose.explanations.doubts import (
    CERTAIN,
    LITTLE,
    UNTURNED,
    may_hang,
    only_slows,
    slight,
    unrested,
)
from vidphys.diagnose.explanations.rivals import CLEAR, SEEN, undecided
from vidphys.diagnose.mechanisms import coupled, ranking, view
from vidphys.diagnose.mechanisms.charts import Arc, Line
from vidphys.diagnose.mechanisms.fitted import USUAL_SLANT
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.mechanism import find_mechanism
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer
from vidphys.experiments.filmed.laws.pendulums import COUPLED_PENDULUMS, DOUBLE_PENDULUM

STEP = 1 / 30
PULLED = Law(2, "uniform", "none", pictured=True)


def filmed(path, tilt):
    """A plane's places ``(t, 2)`` as a camera shows them that is tilted against it."""
    seen = view.seen(path, np.array([tilt, 0.0, 0.0]))
    noise = np.random.default_rng(0).normal(0, 2e-4, path.shape)
    return motion_of((seen + noise)[None, :, None], STEP)


def swung(size, rate, damping, seconds=4.0):
    times = np.arange(round(seconds / STEP)) * STEP
    return size * np.exp(-damping * times / 2) * np.cos(rate * times + 0.4)


@pytest.mark.parametrize("tilt", [pytest.param(-0.28, marks=pytest.mark.slow), 0.2])
def test_a_tilted_spring_is_no_pendulum_seen_edge_on(tilt):
    along = np.array([0.99, 0.14])
    path = np.array([-0.05, -0.16]) + swung(0.16, 4.2, 0.37)[:, None] * along
    found = find_mechanism(filmed(path, tilt), camera=True)
    assert found.kinds == {"trap", "linear"}
    assert all(x.model.charts[0].name != "arc" for x in found.groups[0].others)
    value, error = found.groups[0].fit.numbers["linear"]
    assert abs(value - 0.37) < 4 * error


def pendulum():
    angle = swung(0.35, 4.2, 0.2)
    return 0.6 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1) * [1.0, 0.87] - [0.0, 0.2]


def test_a_tilted_pendulum_stays_one():
    assert find_mechanism(filmed(pendulum(), 0.15), camera=True).kinds == {"pendulum", "linear"}


def test_an_arc_pays_for_its_slant_as_a_camera_for_an_unusual_turn():
    fit = find_mechanism(filmed(pendulum(), 0.0)).groups[0].fit
    model = replace(fit.model, charts=(Arc(aslant=True),))

    def score(tangent):
        up = np.cos(np.arctan(tangent))
        return replace(
            fit, model=model, geometry=(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 2 * up]),)
        ).score

    assert score(0.0) - score(USUAL_SLANT) == pytest.approx(np.log(2))
    assert score(0.0) - score(100 * USUAL_SLANT) == pytest.approx(np.log(1 + 1e4))


@pytest.mark.parametrize(("up", "tangent"), [(1.0, 0.0), (np.cos(np.pi / 6), np.tan(np.pi / 6))])
def test_the_slant_of_an_arc(up, tangent):
    geometry = np.array([0.3, 0.1, 2.0, 0.0, 0.0, 2.0 * up])
    assert Arc(aslant=True).slant(geometry) == pytest.approx(tangent)


PENDULUM, FILMED = (
    SimpleNamespace(
        pictured=pictured, restoring="pendulum", coordinates=1, walls=(), frictions=("linear",)
    )
    for pictured in (False, True)
)


@pytest.mark.parametrize(
    ("law", "kinds", "behind", "smooth", "doubt"),
    [
        (PENDULUM, {"trap", "linear"}, 0.5 * CLEAR, 0.0, True),
        (PENDULUM, {"trap", "linear"}, 1.5 * CLEAR, 0.0, False),
        (PENDULUM, {"trap", "linear"}, 1.5 * CLEAR, 2.0, True),  # errors that last are known less
        (PENDULUM, {"trap", "linear"}, 2.5 * CLEAR, 2.0, False),
        (PENDULUM, {"pendulum", "square"}, 0.5 * CLEAR, 0.0, True),
        (PENDULUM, {"pendulum", "linear", "square"}, 0.5 * CLEAR, 0.0, False),  # and one more
        (FILMED, {"pendulum", "square"}, 0.9 * SEEN, 0.0, True),  # so are a camera's
        (FILMED, {"pendulum", "square"}, 1.1 * SEEN, 0.0, False),
    ],
)
def test_a_law_that_does_without_a_told_term_and_is_as_likely_leaves_doubt(
    law, kinds, behind, smooth, doubt, monkeypatch
):
    monkeypatch.setattr(rivals, "doubts", lambda _: [])
    fit, other = (
        SimpleNamespace(
            kinds=frozenset(x),
            score=s,
            errors=SimpleNamespace(white=1.0, smooth=smooth),
            model=SimpleNamespace(law=law, charts=(None,)),
            numbers={},
        )
        for x, s in (({"pendulum", "linear"}, 0.0), (kinds, -behind))
    )
    found = SimpleNamespace(groups=[SimpleNamespace(fit=fit, others=[other])])
    assert undecided(found) is doubt


@pytest.mark.parametrize(("restoring", "doubt"), [("pendulum", True), ("uniform", False)])
def test_what_swings_without_friction_leaves_doubt_where_one_is_as_likely(
    restoring, doubt, monkeypatch
):
    monkeypatch.setattr(rivals, "doubts", lambda _: [])
    law = SimpleNamespace(**{**vars(PENDULUM), "restoring": restoring, "frictions": ()})
    errors, model = SimpleNamespace(white=1.0, smooth=0.0), SimpleNamespace(law=law, charts=(None,))
    fit, other = (
        SimpleNamespace(kinds=frozenset(x), score=s, errors=errors, model=model, numbers={})
        for x, s in (({restoring}, 0.0), ({restoring, "linear"}, -0.5 * CLEAR))
    )
    found = SimpleNamespace(groups=[SimpleNamespace(fit=fit, others=[other])])
    assert undecided(found) is doubt


@pytest.mark.parametrize(("better", "pulls"), [(0.5, True), (1.5, False)])
def test_springs_that_push_must_be_clearly_likelier_than_springs_that_hold(better, pulls):
    hold, push = (
        SimpleNamespace(score=s, numbers={"coupling 1": (k, 0.1), "coupling 2": (k, 0.1)})
        for s, k in ((0.0, 5.0), (better * coupled.CLEARLY, -9.0))
    )
    assert (max(hold, push, key=coupled._usual) is hold) is pulls


@pytest.mark.parametrize(
    ("size", "turn", "doubt"),
    [(0.1, 0.0, True), (0.3, 0.0, True), (0.5, 0.0, False), (0.1, 1.4, False)],
)
def test_what_swings_little_on_a_level_line_may_be_a_pendulum(size, turn, doubt):
    along = np.array([np.cos(turn), np.sin(turn)])
    path = np.array([-0.05, -0.16]) + swung(size, 4.2, 0.37)[:, None] * along
    fit = find_mechanism(filmed(path, 0.0), camera=True).groups[0].fit
    assert fit.kinds == {"trap", "linear"} and may_hang(fit) is doubt


@pytest.mark.parametrize(
    ("turns", "sizes", "doubt"),
    [((0, 0), (0.1, 0.2), True), ((0, 0), (0.1, 0.6), False), ((0, 1.4), (0.1, 0.2), False)],
)
def test_of_two_that_a_spring_ties_each_must_be_able_to_hang(turns, sizes, doubt):
    law = Law(2, "trap", "linear", apart=True, coupled=True, pictured=True)
    along = tuple(Line((float(np.cos(turn)), float(np.sin(turn)))) for turn in turns)
    swings = np.array(sizes) * np.cos(4.2 * np.arange(60) / 30)[:, None]
    model = SimpleNamespace(
        law=law, charts=along, coordinates=lambda *_: [np.stack([swings] * 2, 1)]
    )
    numbers = {"stiffness 1": (17.6, 0.1), "coupling 1": (3.0, 0.1), "stiffness 2": (17.6, 0.1)}
    fit = SimpleNamespace(model=model, numbers=numbers, values=None, clips=None)
    assert may_hang(fit) is doubt


@pytest.mark.parametrize(
    ("begins", "gains", "doubt"), [(1.0, -0.5, True), (0.2, 0.5, False), (0.5, -0.6, False)]
)
def test_a_force_that_only_slows_what_goes_straight_may_be_dry_friction(begins, gains, doubt):
    times = np.arange(45) * STEP
    path = np.array([-0.5, -0.2]) + np.outer(begins * times + gains * times**2 / 2, [1.0, 0.1])
    found = find_mechanism(filmed(path, 0.0), camera=True).groups[0]
    pulled = [x for x in (found.fit, *found.others) if x.kinds == {"uniform"}]
    assert {x.model.charts[0].name for x in pulled} == {"line", "plane"}
    assert all(only_slows(x) is doubt for x in pulled)
    assert found.fit.kinds == ({"dry"} if doubt else {"uniform"})


@pytest.mark.parametrize(("aside", "doubt"), [(0.03, True), (0.3, False)])
def test_what_nearly_rests_goes_along_its_force_though_it_goes_a_little_aside(aside, doubt):
    speed = np.stack([np.linspace(1.0, 0.02, 45), np.full(45, aside)], -1)
    rates = np.stack([np.zeros_like(speed), speed], 1)
    model = SimpleNamespace(law=PULLED, coordinates=lambda *_: [rates])
    numbers = {name: (x, 0.01) for name, x in zip(PULLED.forces, (-0.67, 0.0), strict=True)}
    fit = SimpleNamespace(model=model, kinds={"uniform"}, numbers=numbers, values=None, clips=None)
    assert only_slows(fit) is doubt


# several that swing


def in_picture(places, tilt=0.0):
    """Places ``(t, n, 2)`` in metres as a picture of a metre and a half shows them."""
    flat = (places - places.mean((0, 1))) / 0.75
    seen = view.seen(flat, np.array([0.0, tilt, 0.0]))
    noise = np.random.default_rng(1).normal(0, 3e-4, seen.shape)
    return motion_of((seen + noise)[None], STEP)


@pytest.mark.slow
def test_a_spring_between_pendulums_is_drawn_between_their_ends():
    times = np.arange(160) * STEP
    length, stiffness, apart = 0.6, 3.7, 0.3
    numbers = np.array([length, 0.05, stiffness, apart, -0.33, 0.0])
    given = answer(in_picture(COUPLED_PENDULUMS.path(numbers, times)), False, 0.3, camera=True)
    assert given.data["terms"] == ["linear", "pair", "pendulum"]
    known = given.data["mechanism"][0]["quantities"]
    for name in ("rate 1", "rate 2"):
        off = abs(known[name]["value"] / np.sqrt(9.81 / length) - 1)
        assert off < 0.002, (name, off)  # 0.004 where it joins the angles
    (spring,) = from_config(given.specification["terms"]).springs
    assert isinstance(spring, Spring)
    assert spring.apart == pytest.approx(apart / length, rel=0.15)
    assert spring.stiffness == pytest.approx(stiffness, rel=0.04)


def test_a_double_pendulum_that_is_seen_aslant_stays_one():
    times = np.arange(150) * STEP
    numbers = np.array([0.3, 0.3, 1.0, 0.87, 0.85])
    places = DOUBLE_PENDULUM.path(numbers, times) * [1.0, 0.86]  # the view's own 0.93 makes it 0.8
    given = answer(in_picture(places, 0.25), False, 0.4, camera=True)
    assert given.data["terms"] == ["chain"]


def test_a_spring_that_is_not_seen_to_turn_leaves_doubt():
    phase = np.linspace(0.15, 2.95, 60)  # less than half a swing, from end to end
    path = np.stack([-0.5 * np.cos(phase), np.full(60, -0.1)], -1)
    given = answer(filmed(path, 0.0), False, 0.2, camera=True)
    assert "trap" in given.data["terms"] and given.data["status"] != "explained"
    assert UNTURNED in given.lines


@pytest.mark.parametrize(
    ("friction", "times", "seconds", "told"),
    [
        ("linear", 0.5, 9.0, ["linear", "uniform"]),
        ("linear", 2.0, 9.0, []),
        ("linear", -2.0, 9.0, []),  # a drive
        ("linear", 2.0, 0.5 * LITTLE / (2 * CERTAIN), ["linear"]),  # it took too little by then
        ("none", 0.5, 9.0, []),  # what a body falls by alone is no term beside others
    ],
)
def test_a_term_that_is_as_small_as_its_error_is_hardly_told_from_none(
    friction, times, seconds, told
):
    law = Law(2, "uniform", friction, pictured=True)
    numbers = {name: (times * CERTAIN, 1.0) for name in ("force 1", "linear")}
    numbers |= {"force 2": (0.0, 1.0)}
    clips, model = [SimpleNamespace(times=np.array([0.0, seconds]))], SimpleNamespace(law=law)
    assert slight(SimpleNamespace(model=model, numbers=numbers, clips=clips)) == told


@pytest.mark.parametrize("space", [1, 2])
@pytest.mark.parametrize("rests", [1.0, 1.5, 2.2])  # seconds, of two that are seen
def test_what_rolls_until_it_rests_is_rubbed(space, rests):
    times = np.arange(60) * STEP
    moving = np.minimum(times, rests)
    way = 1.5 * (moving - moving**2 / (2 * rests)) - 0.5
    path = np.outer(way, [1.0, 0.02]) - [0.0, 0.3]
    motion = filmed(path, 0.0) if space == 2 else motion_of(way[None, :, None, None], STEP)
    best = find_mechanism(motion, camera=space == 2).groups[0].fit
    assert best.kinds == {"dry"}
    assert best.numbers["dry"][0] == pytest.approx(1.5 / rests, rel=0.03)
    assert unrested(best) is (space == 2 and rests > 2.0)


@pytest.mark.parametrize(
    ("behind", "coasts", "first"),
    [(8.0, True, "none"), (8.0, False, "uniform"), (14.0, True, "uniform")],
)
def test_dry_friction_is_likelier_than_a_pull_that_only_slows(monkeypatch, behind, coasts, first):
    def fitted(restoring, friction, numbers, score):
        law = SimpleNamespace(restoring=restoring, friction=friction, curve=None)
        model = SimpleNamespace(law=law)
        return SimpleNamespace(model=model, score=score, covariance=np.eye(numbers))

    monkeypatch.setattr(ranking, "_coasts", lambda found: coasts)
    pull, dry = fitted("uniform", "none", 6, 0.0), fitted("none", "dry", 5, -behind)
    assert ranking.ranked([pull, dry])[0].model.law.restoring == first
