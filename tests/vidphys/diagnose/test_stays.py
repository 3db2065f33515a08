"""Where no law foretells what it was fitted to, the forecast is that the bodies stay."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations import choice
from vidphys.diagnose.explanations.explanation import Explanation
from vidphys.diagnose.explanations.forecast import State, beside_simple, inner_ends, last_seen
from vidphys.diagnose.explanations.mechanism import ByMechanism
from vidphys.diagnose.explanations.standing import Standing
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY, NOT, Verdict, judge
from vidphys.diagnose.mechanisms.mechanism import find_mechanism
from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.telling.answers import answer
from vidphys.diagnose.telling.report import _verdict

FRAMES, END = 40, 24


def walk(seed):
    """A body that goes on for a while, by chance."""
    random = np.random.default_rng(seed)
    speed, steps = np.zeros(2), []
    for _ in range(FRAMES):
        speed = 0.8 * speed + 0.02 * random.standard_normal(2)
        steps.append(speed)
    return np.cumsum(steps, 0)


def hopping(seed):
    """Whoever follows it is now at a thing that swings, now at one that goes by."""
    random, t = np.random.default_rng(seed), np.arange(FRAMES) / 30
    swings = np.stack([0.3 + 0.3 * np.sin(4 * t), 0.2 + 0.1 * np.cos(4 * t)], -1)
    passes = np.stack([0.1 * t - 0.3, 0.05 * np.sin(t) - 0.2], -1)
    noise = 0.003 * random.standard_normal((FRAMES, 2))
    places, at = swings + noise, 0
    while at < FRAMES:
        stays = int(random.integers(8, 30))
        if random.random() < 0.5:
            places[at : at + stays] = (passes + noise)[at : at + stays]
        at += stays
    return places


def by_law(path):
    motion = path if isinstance(path, Motion) else motion_of(path[None, :, None], 1 / 30)
    law = ByMechanism.of(motion, END, False, True, Units())
    assert law is not None
    return law, motion


@pytest.mark.slow
@pytest.mark.parametrize("path", [walk(2), hopping(5)])
def test_what_moves_by_no_law_is_foretold_to_stay_where_it_was_seen_last(path):
    law, motion = by_law(path)
    tail = law.forecast()
    assert law.stays and law.verdict.status == NOT and law.verdict.stays
    last = np.broadcast_to(path[END - 1], (FRAMES - END, 1, 2))
    np.testing.assert_array_equal(tail.forecasts["model"], last)
    assert tail.errors["model"] == tail.errors["persistence"]
    later = motion.positions.copy()
    later[:, END:] = later[:, END - 1 : END]  # frames that were held out have no say
    assert replace(law, motion=replace(motion, positions=later)).stays


def swing(rate, fade=0.1):
    t = np.arange(FRAMES) / 30
    return np.stack([0.5 * np.exp(-fade * t) * np.cos(rate * t), 0 * t], -1)


def slid():
    t = np.minimum(np.arange(FRAMES) / 30, 1.0)  # at rest from then on
    return np.stack([0.6 * t - 0.3 * t**2, 0 * t], -1)


@pytest.mark.parametrize("path", [swing(6.0), slid()])
def test_what_a_law_moves_is_foretold_by_it_also_where_it_comes_to_rest(path):
    law, _ = by_law(noisy(path[:, None], 2e-3, 1 / 30))
    assert not law.stays and law.verdict.status != NOT
    assert law.forecast().errors == law.rolled_on().errors


@pytest.mark.parametrize(("status", "is_then"), [(EXPLAINED, MOSTLY), (MOSTLY, MOSTLY), (NOT, NOT)])
def test_a_law_is_judged_by_what_was_held_out_also_where_it_is_not_what_is_foretold(
    status, is_then, monkeypatch
):
    law, _ = by_law(noisy(swing(6.0)[:, None], 2e-3, 1 / 30))
    judged = replace(law.judged(law.tail), status=status)
    monkeypatch.setattr(ByMechanism, "judged", lambda *_: judged)
    vars(law)["stays"] = True  # by what a rehearsal would say
    assert law.verdict.status == is_then and law.verdict.stays
    said = _verdict(law.verdict, 1)
    assert ("would have foretold 0.133 s of the 0.5 s held out, but" in said) is (is_then == MOSTLY)
    assert ("but does not foretell it" in said) is (is_then == NOT)
    assert said.endswith("So the forecast is that it stays where last seen.")


@dataclass(frozen=True)
class Straight(Explanation):
    """One that says that a body goes straight on, by its last two frames."""

    motion: Motion
    end: int

    kinds = []
    fastest = 0.0

    def lines(self):
        return ["It goes straight on."]

    def judged(self, tail):
        return judge(0.999, 0.1, 1.0, tail)

    def path(self):
        return self.motion.times[0], self.motion.positions[0]

    def rolled_on(self):
        if self.end == self.motion.positions.shape[1]:
            return None
        before, last = self.motion.positions[0, self.end - 2 : self.end]
        times, h = self.motion.times[0], self.motion.interval
        speed = (last - before) / h
        path = last + speed * (times[self.end :, None, None] - times[self.end - 1])
        start = State(float(times[self.end - 1]), last, speed, np.ones(1))
        return beside_simple(path, self.motion, self.end, start, 0 * speed)

    def earlier(self):
        return [Straight(self.motion.cut(0, self.end), self.end // 2)]

    def changed(self):
        return {"no inertia": (self.motion.times[0], self.motion.positions[0])}

    def specification(self):
        return None


@pytest.mark.parametrize("turns", [True, False])
def test_it_is_said_and_written_that_it_stays_and_nothing_else_is_foretold(turns, monkeypatch):
    monkeypatch.setattr(choice, "FITTED", (lambda motion, end, *_: Straight(motion, end),))
    monkeypatch.setattr(choice, "strikes", lambda _: [(0, 0.0)])  # so that the menu is not asked
    t = np.arange(FRAMES) * 0.05
    path = np.stack([np.sin(6 * t) if turns else t, 0.1 * t], -1)
    given = answer(motion_of(path[None, :, None], 0.05), False, 0.4)
    said = "So the forecast is that it stays where last seen."
    assert any(said in line for line in given.lines) is turns
    assert given.data["stays"] is given.stays is turns
    assert given.data["status"] == (NOT if turns else EXPLAINED)
    assert list(given.rolled) == ["model"] if turns else ["model", "no inertia"]
    errors = given.data["forecast_error"]
    assert (errors["model"] == errors["persistence"]) is turns
    assert given.numbers["forecast_rmse_model"] == errors["model"]
    assert len(given.path[0]) == (END if turns else FRAMES)


@pytest.mark.parametrize("share", [0.995, 0.97])
def test_the_menu_is_not_asked_where_several_laws_foretell_all(share):
    verdict = Verdict(MOSTLY, share, 0.01, horizon=2.0, held_out=2.0)
    laws = Standing(MOSTLY, verdict, 0.01)
    assert choice._enough(laws, one_law=False) is (share > 0.99)
    assert choice._enough(laws, one_law=True)
    early = replace(laws, verdict=replace(verdict, horizon=1.5))
    assert not choice._enough(early, one_law=False)


def test_frames_too_few_to_show_a_force_tell_of_no_law():
    assert inner_ends(60, 100) == [36, 48]  # as large a share as is held out of all, and half
    assert inner_ends(20, 30) == [12, 12] and inner_ends(12, 20) == []


def test_each_body_was_last_seen_in_its_own_frame():
    places = np.arange(12.0).reshape(3, 2, 2)
    places[2, 0] = np.nan
    places[:, 1] = np.nan
    np.testing.assert_array_equal(last_seen(places, np.full((2, 2), 7.0)), [[4, 5], [7, 7]])


@pytest.mark.parametrize("frames", [1, 20])
def test_dry_friction_stops_what_is_seen_to_move_and_not_a_frame_that_is_off(frames):
    """A tracker that begins a frame off is no body that comes to rest at once."""
    left = np.maximum(frames - np.arange(40), 0.0)
    way = 0.3 * (left / frames) ** 2
    places = np.stack([way, -0.5 * way], -1)[None, :, None]
    noise = 2e-4 * np.random.default_rng(0).standard_normal(places.shape)
    fit = find_mechanism(motion_of(places + noise, 0.04), camera=True).groups[0].fit
    assert (fit.kinds == {"dry"}) is (frames > 1)
