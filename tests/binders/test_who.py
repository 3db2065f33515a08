"""Who is the body: what moves lawfully, and what a person says, on drawn clips with a decoy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binders.candidates import Judging, untangled
from binders.exchanged import continued, crossed
from binders.follow import Candidate, likely, put_last, ranked
from binders.halves import halves
from binders.hypotheses import Hypothesis
from binders.lawful import Judged, foretold
from binders.motion import MotionBinder
from binders.steadied import Steadied
from binders.wanted import Wanted
from binders.wheels import wheels
from tests.binders.test_motion import HEIGHT, WIDTH, disc, draw, pixels, still, times

T = np.arange(60)
BALL = np.stack([12 + 1.6 * T, 20 + 0.05 * (T - 25.0) ** 2], 1)
GREEN = np.array([60.0, 170.0, 70.0])


def wander(seed: int = 3) -> np.ndarray:
    """A large thing that goes here and there, as a person does."""
    steps = np.random.default_rng(seed).normal(size=(60, 2))
    slow = np.stack([np.convolve(s, np.ones(7) / 7, "same") for s in steps.T], 1)
    return np.array([62.0, 70.0]) + [12.0, 3.0] * np.cumsum(slow, 0)


def clip(paths: dict[float, np.ndarray], colours: dict[float, np.ndarray]) -> np.ndarray:
    """Discs by their radius on the wall of the other tests, without strings or shadows."""
    frames = draw(np.zeros((60, 0, 2)), still()).astype(float)
    for radius, path in paths.items():
        for image, centre in zip(frames, path, strict=True):
            body = disc(centre, radius)
            image[:] = image * (1 - body) + colours[radius] * body
    return np.clip(frames, 0, 255).astype(np.uint8)


def ball_and_person() -> np.ndarray:
    red, coat = np.array([200.0, 40, 30]), np.array([30.0, 60, 200])
    return clip({4.0: BALL, 8.0: wander()}, {4.0: red, 8.0: coat})


def error(frames: np.ndarray, path: np.ndarray, **settings: object) -> float:
    found = MotionBinder(**settings)(frames, times())
    seen = found.tracks.confidence[0, :, 0].numpy() > 0
    assert seen.mean() > 0.8  # the picture's edge may cut it
    return float(np.linalg.norm(pixels(found)[:, 0] - path, axis=-1)[seen].max())


@pytest.mark.slow
def test_a_small_ball_is_followed_beside_a_person() -> None:
    assert error(ball_and_person(), BALL) < 1.0


@pytest.mark.parametrize(
    "wanted",
    [
        pytest.param(Wanted(at=((*wander()[30].tolist(), 30),)), marks=pytest.mark.slow),
        pytest.param(Wanted(region=(0.0, 50.0, 75.0, 46.0)), marks=pytest.mark.slow),
        Wanted(colour=(30, 60, 200)),
        pytest.param(Wanted(size=16.0), marks=pytest.mark.slow),
        pytest.param(
            Wanted(mask=np.arange(WIDTH) < np.where(np.arange(HEIGHT) > 50, 75, 0)[:, None]),
            marks=pytest.mark.slow,
        ),
        pytest.param(Wanted(choose=(2,)), marks=pytest.mark.slow),
    ],
    ids=["at", "region", "colour", "size", "mask", "choose"],
)
def test_a_person_says_otherwise(wanted: Wanted) -> None:
    assert error(ball_and_person(), wander(), wanted=wanted) < 1.5


@pytest.mark.slow
def test_a_ball_stands_out_of_the_person_it_passes_before() -> None:
    swing = np.stack([62 + 20 * np.cos(0.21 * T), 44 + 3 * np.cos(0.42 * T)], 1)
    coat, red = np.array([30.0, 60, 200]), np.array([200.0, 40, 30])
    frames = clip({18.0: 0.3 * wander() + [43.0, 31.0], 4.0: swing}, {18.0: coat, 4.0: red})
    places, _ = MotionBinder().candidates(frames, times())
    off = np.linalg.norm(places - swing[:, None], axis=-1)
    assert (off < 1.0).mean(0).max() > 0.9


def test_a_candidate_that_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match="choose 40: there are candidates 1 to"):
        MotionBinder(wanted=Wanted(choose=(40,)))(ball_and_person()[:20], times()[:20])


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        (Wanted(region=(500.0, 0.0, 5.0, 5.0)), "leave nothing of the picture"),
        (Wanted(mask=np.ones((9, 9), bool)), "the clip has another size"),
        (Wanted(at=((3.0, 3.0, 99),)), "frames that are used are 0 to 19"),
    ],
)
def test_what_no_such_clip_can_show_is_refused_before_anything_is_looked_for(
    wanted: Wanted, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("binders.motion.Steadied", None)
    with pytest.raises(ValueError, match=said):
        MotionBinder(wanted=wanted)(np.zeros((20, HEIGHT, WIDTH, 3), np.uint8), times()[:20])


def test_as_many_bodies_as_move_lawfully() -> None:
    other = np.stack([112 - 1.5 * T, 60 + 12 * np.cos(0.2 * T)], 1)
    red, green = np.array([200.0, 40, 30]), GREEN
    frames = clip({5.0: BALL, 5.5: other}, {5.0: red, 5.5: green})
    assert MotionBinder(bodies=None)(frames, times()).tracks.positions.shape[2] == 2
    alone = MotionBinder(bodies=None)(ball_and_person(), times())
    assert alone.tracks.positions.shape[2] == 1
    seen = alone.tracks.confidence[0, :, 0].numpy() > 0
    assert seen.mean() > 0.8
    assert np.linalg.norm(pixels(alone)[:, 0] - BALL, axis=-1)[seen].max() < 1.0


def test_candidates_come_in_the_order_of_choosing() -> None:
    places, radii = MotionBinder().candidates(ball_and_person(), times())
    for k, (path, radius) in enumerate(((BALL, 4.0), (wander(), 8.0))):
        assert np.nanmax(np.linalg.norm(places[:, k] - path, axis=-1)) < 1.5
        assert radii[k] == pytest.approx(radius, rel=0.15)


def test_a_body_that_stands_behind_another_for_a_while_is_kept() -> None:
    """In the middle of the clip a broad post hides all but the looks of half of it."""
    there = np.where(T < 20, 20 + 2.0 * T, np.where(T < 45, 60.0, 60 + 2.0 * (T - 45)))
    path = np.stack([there, np.full(60, 40.0)], 1)
    frames = clip({5.0: path}, {5.0: np.array([200.0, 40, 30])})
    found = MotionBinder()(frames, times())
    assert np.abs(pixels(found)[:, 0] - path).max() < 1.0
    assert (found.tracks.confidence > 0).all()


def test_a_body_that_comes_nearer_grows() -> None:
    radius = np.linspace(4, 8, 60)
    frames = draw(np.zeros((60, 0, 2)), still()).astype(float)
    for image, centre, r in zip(frames, BALL, radius, strict=True):
        body = disc(centre, r)
        image[:] = image * (1 - body) + np.array([200.0, 40, 30]) * body
    found = MotionBinder()(np.clip(frames, 0, 255).astype(np.uint8), times())
    assert found.radius is not None
    seen = found.radius[:, 0].numpy() * WIDTH / 2
    assert np.nanmax(np.abs(seen / radius - 1)) < 0.15


def test_a_throw_is_foretold_and_a_hand_is_not() -> None:
    steps = np.arange(60.0)
    noise = np.random.default_rng(0).normal(scale=0.2, size=(60, 2))
    bounce = np.stack([2.0 * T, 60 - 40 * np.abs(np.sin(0.16 * T))], 1)
    hand, throw = (foretold(path + noise, steps) for path in (wander(), BALL))
    assert throw > 2 * hand and foretold(bounce + noise, steps) > 1.5 * hand


def test_a_ball_is_foretold_by_its_flight_though_it_was_held_before() -> None:
    noise = np.random.default_rng(1).normal(size=(46, 2)) * 0.1
    swing = np.array([[0.0, -0.5 * k**2] for k in range(7)])
    flight = np.array([[3.0 * k, -6.0 * k + 0.5 * k**2] for k in range(1, 20)]) + swing[-1]
    ball, steps = np.concatenate([np.zeros((20, 2)), swing, flight]) + noise, np.arange(46.0)
    assert foretold(ball, steps) > 0.4 * foretold(ball[27:], steps[27:])


def test_a_few_frames_of_motion_prove_little() -> None:
    throw = np.stack([2.0 * T, 0.04 * (T - 30.0) ** 2], 1)
    few = np.where(np.arange(60)[:, None] < 8, throw, np.nan)
    assert foretold(few, T.astype(float)) < 0.7 * foretold(throw, T.astype(float))


def test_a_body_that_was_followed_in_two_parts_is_one() -> None:
    """One is lost to a hand at the end, the other was a hand at the beginning."""
    column = np.full(60, 5.0)

    def body(path: np.ndarray) -> Hypothesis:
        return Hypothesis(path, column, column, column, np.zeros((60, 3)), column, column)

    early = body(np.where(T[:, None] < 35, BALL, wander()))
    late = body(np.where(T[:, None] < 25, wander(), BALL))
    whole, hand = crossed([early, late])
    assert np.array_equal(whole.positions, BALL)
    assert np.abs(hand.positions[:25] - wander()[:25]).max() == 0
    assert not crossed([early, body(BALL + 3.0)])


def part(first: int, stop: int, path: np.ndarray = BALL, size: float = 5.0) -> Hypothesis:
    """What was followed from one frame to before another."""
    seen = (first <= T) & (stop > T)
    column = np.where(seen, size, np.nan)
    places = np.where(seen[:, None], path, np.nan)
    return Hypothesis(places, column, column, column, np.zeros((60, 3)), column, column)


def test_a_body_that_was_lost_and_found_again_is_one() -> None:
    early, middle, late = part(0, 20), part(24, 41), part(43, 60)
    first, second = continued([late, early, middle], T.astype(float))
    assert np.array_equal(first.seen, early.seen | middle.seen | late.seen)
    assert np.array_equal(first.positions[first.seen], BALL[first.seen])
    assert np.array_equal(second.seen, middle.seen | late.seen)


@pytest.mark.parametrize(
    "other",
    [
        part(34, 60),  # long after
        part(24, 60, size=9.0),  # another
        part(24, 60, BALL + 30.0),  # elsewhere
        part(15, 60),  # while it is seen itself
    ],
)
def test_what_is_another_body_is_not_the_one_that_was_lost(other: Hypothesis) -> None:
    assert not continued([part(0, 20), other], T.astype(float))


def candidate(
    path: np.ndarray, score: float, size: float = 5.0, steady: float = 0.95, seen: float = 1.0
) -> Candidate:
    column = np.full(60, size)
    body = Hypothesis(path, column, column, column, np.zeros((60, 3)), column, column)
    foretold = score / steady / seen**0.6
    return Candidate(body, Judged(seen, foretold, steady, 1.0, 1.0, 1.0, 1.0, 0.0), 0)


def test_a_body_is_followed_as_long_as_it_is_seen() -> None:
    def lost(from_: int, score: float) -> Candidate:
        return candidate(np.where(T[:, None] < from_, BALL, np.nan), score, seen=from_ / 60)

    short, long = lost(20, 1.0), lost(60, 0.9)
    assert ranked([short, long]) == [long]
    assert ranked([short, lost(25, 0.9)]) == [short]  # hardly longer
    assert ranked([short, lost(60, 0.5)])[0] == short  # far less likely
    larger = candidate(BALL, 0.9, size=6.7)
    assert ranked([short, larger]) == [short]  # another, which it goes with for a while
    otherwise = replace(larger, kind=1)  # by colour the same body may show more of itself
    assert ranked([short, otherwise]) == [otherwise]


def test_what_is_followed_on_as_another_body_gives_way_to_what_is_not() -> None:
    before = T[:, None] < 34
    one, two = BALL, BALL + 50.0
    first, stays = candidate(one, 1.0), candidate(two, 0.8, size=4.0)
    exchanged = candidate(np.where(before, two, one), 0.9)
    assert ranked([first, exchanged, stays]) == [first, stays]
    assert ranked([first, exchanged, candidate(two, 0.5)])[:2] == [first, exchanged]


def test_bodies_that_were_exchanged_where_they_met_give_way_to_one_that_was_not() -> None:
    """The large one rests until the small one strikes it; only its corners tell of it till then."""
    after = np.maximum(T - 24.0, 0)[:, None]
    small = np.array([40.0, 50]) + (T - 24.0)[:, None] * [1.2, 0.4] - after * [1.0, 1.1]
    large = np.array([50.0, 50]) + after * [0.4, 0.2]
    unsure = large + 3 * np.random.default_rng(0).normal(size=(60, 2)) * (after == 0)

    def body(before: np.ndarray, later: np.ndarray, sizes: tuple[float, float]) -> Hypothesis:
        size = np.where(T < 24, *sizes)
        ones, places = np.ones(60), np.where(after == 0, before, later)
        return Hypothesis(places, size**2, size, size, np.zeros((60, 3)), ones, 0 * ones)

    clip = Steadied(draw(np.zeros((60, 0, 2)), still()), times())
    mixed = body(small, large, (5.0, 9.0)), body(unsure, small, (9.0, 5.0))
    whole = body(large, large, (9.0, 9.0))
    judging = Judging(clip, Wanted())
    judged = [*judging(list(mixed), 0), *judging([whole], 2)]
    assert all(x.body is y for x, y in zip(ranked(judged), mixed, strict=True))
    first, second = ranked(untangled(judging, judged))
    assert (first.body.positions == small).all(1).mean() > 0.9 and second.body is whole


@pytest.mark.parametrize(
    ("turns", "away", "size", "bodies"),
    [
        (0.02, 4.0, 5.0, 1),
        (0.0, 4.0, 5.0, 0),
        (0.02, 9.0, 5.0, 0),
        (0.02, 4 + np.sin(T / 5), 5.0, 0),
        (0.02, 4.0, 7.0, 0),
    ],
    ids=["a striped puck", "two that go alike", "two on a rod", "on a spring", "of other sizes"],
)
def test_two_halves_that_a_stripe_parts_are_one_body(turns, away, size, bodies) -> None:
    """The puck hardly moves, so what stands still shows it, and only its colour tells of it."""
    middle = np.array([60.0, 40.0]) + np.outer(T, [0.2, 0.1])
    arm = (away * np.stack([np.cos(turns * T), np.sin(turns * T)])).T
    pieces = [part(0, 60, middle + arm), part(3, 60, middle - arm, size), part(0, 60, wander())]
    found = halves(pieces)
    assert len(found) == bodies
    if bodies:
        np.testing.assert_allclose(found[0].positions[3:], middle[3:])
        assert found[0].seen.sum() == 57 and found[0].usual_size == pytest.approx(5 * 2**0.5)


def turning(*found: Candidate) -> set[int]:
    return wheels([each.body for each in found])


def test_the_blades_of_a_fan_are_no_bodies() -> None:
    turns = 0.3 * T[:, None] + np.arange(3) * 2 * np.pi / 3
    blades = np.stack([30 + 12 * np.cos(turns), 40 + 12 * np.sin(turns)], -1)
    fan = [candidate(blades[:, k], 2.0 - 0.1 * k) for k in range(3)]
    ball = candidate(BALL, 0.7)
    assert turning(*fan, ball) == {0, 1, 2}
    assert turning(*fan[:2], ball) == set()  # two may be bodies on a rod
    assert likely(put_last([*fan, ball], {0, 1, 2})) == [ball.body]


def test_blades_are_known_though_who_follows_them_exchanges_them() -> None:
    rng = np.random.default_rng(0)
    turns = 0.5 * T[:, None] + rng.integers(0, 3, (60, 4)) * 2 * np.pi / 3
    blades = np.stack([30 + 12 * np.cos(turns), 40 + 12 * np.sin(turns)], -1)
    fan = [candidate(blades[:, k], 1.0) for k in range(3)]
    hub = candidate(np.array([31.0, 40.0]) + 2 * rng.normal(size=(60, 2)), 1.0)
    larger = candidate(30 + 2 * (blades[:, 3] - [30, 40]), 1.0)  # as of a body on its orbit
    assert turning(candidate(BALL, 0.7), *fan, hub, larger) == {1, 2, 3, 4}
    seldom = candidate(np.where(T[:, None] < 24, blades[:, 2], np.nan), 1.0)
    assert turning(*fan[:2], larger, seldom) == set()


def test_glimpses_here_and_there_are_no_blades() -> None:
    """As of the coils of a spring between two weights, each of which is followed now and then."""
    places = [50, 40] + 20 * np.array([[np.cos(a), np.sin(a)] for a in np.arange(6) * np.pi / 3])
    rng = np.random.default_rng(0)
    glimpses = [candidate(places[rng.integers(0, 6, 60)], 0.3) for _ in range(4)]
    weight = candidate(np.stack([50 + 15 * np.sin(0.3 * T), 45 + 0 * T], 1), 1.6)
    assert turning(weight, *glimpses) == set()


def test_a_pendulum_before_a_fan_is_none_of_its_blades() -> None:
    turns = 0.5 * T[:, None] + np.arange(3) * 2 * np.pi / 3
    blades = np.stack([30 + 12 * np.cos(turns), 40 + 12 * np.sin(turns)], -1)
    cut = np.where(blades[:, 0, 1:] > 40, blades[:, 0], np.nan)  # by the picture's edge
    swings = np.stack([30 + 10 * np.sin(0.3 * T), 44 + 0 * T], 1)
    fan = [candidate(blades[:, k], 1.0) for k in range(3)]
    assert turning(candidate(swings, 1.6), *fan, candidate(cut, 1.0)) == {1, 2, 3, 4}


@pytest.mark.parametrize(
    ("given", "taken", "bodies"),
    [(0.5, 1.0, 2), (0.5, 0.0, 1), (-0.5, 1.0, 1)],
    ids=["a puck", "what stays", "what is drawn along"],
)
def test_what_strikes_a_body_is_one_too_however_slow_it_is(given, taken, bodies) -> None:
    since = np.maximum(T - 30.0, 0)[:, None]
    fast = np.array([30.0, 40.0]) + (T - 30.0)[:, None] * [1.5, 0.2] - since * [taken * 2.0, 0.0]
    slow = np.array([41.0, 40.0]) + since * [given, 0.0]
    slow[29:32] = fast[29:32] + [[1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]  # they are seen as one
    other = replace(candidate(slow, 0.4, size=6.0), kind=1)
    other = replace(other, judged=replace(other.judged, foretold=0.4, steady=0.8))
    assert 0.15 < other.judged.score / 1.6 < 0.3
    assert len(likely([candidate(fast, 1.6), other])) == bodies


def test_a_body_that_moves_little_is_one_if_it_is_as_large() -> None:
    first = candidate(BALL, 1.3)
    for size, steady, kind, bodies in (
        (5.5, 0.95, 2, 2),
        (1.6, 0.95, 0, 1),
        (5.5, 0.6, 0, 1),
        (7.0, 0.95, 0, 2),  # sizes that were found in one way are compared more freely
        (7.0, 0.95, 2, 1),
    ):
        other = replace(candidate(0.1 * BALL + 60, 0.4, size, steady), kind=kind)
        assert len(likely([first, other])) == bodies


@pytest.mark.parametrize(
    ("odd", "bodies"),
    [({}, 2), ({"lit": 0.5}, 1), ({"foretold": 0.9}, 1), ({"seen": 0.8}, 1), ({"fits": 0.5}, 1)],
)
def test_what_goes_as_bodies_do_and_is_no_shadow_need_be_less_clear(odd, bodies) -> None:
    first = candidate(BALL, 1.3)
    other = replace(candidate(0.5 * BALL + 60, 0.5, 1.6, 0.4), kind=1)
    other = replace(other, judged=replace(other.judged, **odd))
    if not odd:
        assert 0.3 < other.judged.score / first.judged.score < 0.45
    assert len(likely([first, other])) == bodies


@pytest.mark.parametrize(
    ("odd", "bodies"), [({}, 2), ({"seen": 0.95}, 1), ({"steady": 0.59}, 1), ({"foretold": 0.6}, 1)]
)
def test_what_is_always_seen_and_looks_alike_may_be_foretold_less_well(odd, bodies) -> None:
    first = candidate(BALL, 1.9)
    other = replace(candidate(0.5 * BALL + 60, 0.84, 1.6, 0.85), kind=1)
    other = replace(other, judged=replace(other.judged, **odd))
    assert 0.25 < other.judged.score / first.judged.score < 0.45
    assert len(likely([first, other])) == bodies


@pytest.mark.parametrize(
    ("odd", "bodies"), [({}, 2), ({"seen": 0.9}, 1), ({"steady": 0.8}, 1), ({"lit": 0.6}, 1)]
)
def test_what_goes_very_lawfully_may_have_half_the_colour_of_what_is_behind_it(odd, bodies):
    first = candidate(BALL, 1.5)
    other = replace(candidate(0.5 * BALL + 60, 1.6, 3.0), kind=1)
    other = replace(other, judged=replace(other.judged, clear=0.7, fits=0.7, lit=0.4))
    other = replace(other, judged=replace(other.judged, **odd))
    assert 0.3 < other.judged.score / first.judged.score < 0.45
    assert len(likely([first, other])) == bodies


@pytest.mark.parametrize(
    ("size", "high", "share", "bodies"),
    [(2.0, 6.0, 0.9, 1), (2.0, 6.0, -0.9, 2), (2.0, 20.0, 0.9, 2), (3.0, 6.0, 0.9, 2)],
    ids=["of its string", "goes its own way", "away from it", "as large"],
)
def test_a_piece_of_the_string_by_which_a_body_hangs_is_none(size, high, share, bodies):
    swing = np.stack([8 * np.sin(0.3 * T), 0 * T], -1)
    slides = np.random.default_rng(0).normal(size=(60, 2)) * [1.0, 0.5]
    piece = candidate(60 + share * swing - [0.0, high] + slides, 1.0, size)
    assert len(likely([candidate(60 + swing, 1.5), piece])) == bodies


@pytest.mark.parametrize(
    ("size", "foretold", "bodies"), [(5.5, 0.85, 2), (5.5, 0.6, 1), (2.0, 0.85, 1)]
)
def test_beside_one_that_moves_very_lawfully_a_second_as_large_and_steady_is_one_too(
    size, foretold, bodies
) -> None:
    first = candidate(BALL, 2.6)
    other = candidate(0.1 * BALL + 60, 0.9, size, 0.95)
    other = replace(other, kind=1, judged=replace(other.judged, foretold=foretold, fits=0.7))
    if bodies == 2:
        assert 0.2 < other.judged.score / first.judged.score < 0.25
    assert len(likely([first, other])) == bodies


@pytest.mark.parametrize(
    ("size", "steady", "bodies"), [(5.5, 0.95, 2), (5.5, 0.8, 1), (2.0, 0.95, 1)]
)
def test_a_grey_body_that_is_surely_one_thing_is_not_left_out_as_a_shadow(
    size, steady, bodies
) -> None:
    other = candidate(0.1 * BALL + 60, 0.5, size, steady)
    other = replace(other, judged=replace(other.judged, lit=0.6))
    assert other.judged.score < 0.2 * 1.8
    assert len(likely([candidate(BALL, 1.8), other])) == bodies


@pytest.mark.parametrize(
    ("length", "stretch", "sway", "ends"),
    [(30, 0.0, 0.6, 1), (30, 0.2, 0.6, 0), (30, 0.0, 0.1, 0), (6, 0.0, 0.6, 0)],
    ids=["rod", "spring", "goes along", "part"],
)
def test_what_stays_at_one_distance_and_turns_is_the_other_end_of_a_rod(
    length, stretch, sway, ends
) -> None:
    angle, reach = sway * np.sin(0.4 * T), length * (1 + stretch * np.sin(0.9 * T))
    way = np.stack([np.sin(angle), np.cos(angle)], -1)
    first, second = candidate(BALL, 1.0), candidate(wander(), 0.5)
    other = candidate(BALL + reach[:, None] * way, 0.35, 3.0, 0.5)
    found = likely([first, second, other])
    assert len(found) == 2 + ends
    if ends:
        assert found[1] is other.body  # before what may be of any kind


def test_what_turns_by_different_angles_is_no_fan() -> None:
    middle = np.array([30.0, 40.0])
    angles = np.stack([0.8 * np.sin(0.3 * T), 2.1 + 0.1 * np.sin(0.2 * T), 4.2 + 0 * T], -1)
    places = middle + 12 * np.stack([np.cos(angles), np.sin(angles)], -1)
    three = [candidate(places[:, k], 2.0 - 0.1 * k) for k in range(3)]
    assert turning(*three) == set()


def test_a_rod_that_sways_about_its_middle_is_no_fan() -> None:
    angles = 0.2 * np.sin(0.3 * T)
    along = np.stack([np.sin(angles), np.cos(angles)], -1)
    swaying = 40 + along * np.array([75.0, 5.0, -80.0])[:, None, None]
    noise = np.random.default_rng(0).normal(0, 3, swaying.shape)  # turns what is near the middle
    three = [candidate(path, 2.0 - 0.1 * k) for k, path in enumerate(swaying + noise)]
    assert turning(*three) == set()
