"""One body of several that move together: its law is told with reserve."""

import numpy as np
import pytest

from vidphys.diagnose.explanations.mechanism import ByMechanism
from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.fit import race
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.mechanism import Group, Mechanism
from vidphys.diagnose.mechanisms.starts.guesses import guesses
from vidphys.diagnose.mechanisms.unfollowed import alike_every_time, own_swing
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.units import Units
from vidphys.experiments.filmed.laws.law import GRAVITY
from vidphys.experiments.filmed.laws.pendulums import DOUBLE_PENDULUM, PENDULUM
from vidphys.experiments.recorded.curves import BENT_TRAP

STEP = 1 / 30
LENGTHS, RATIO = (0.3, 0.25), 0.25


def filmed(path, noise=0.3):
    """Pixels of places ``(t, 2)`` in metres."""
    return motion_of(
        (500 * path + np.random.default_rng(0).normal(0, noise, path.shape))[None, :, None], STEP
    )


def bob(which, angles, seconds=6.0):
    """One of the two bobs of a double pendulum."""
    times = np.arange(round(seconds / STEP)) * STEP
    return DOUBLE_PENDULUM.path(np.array([*LENGTHS, RATIO, *np.radians(angles)]), times)[:, which]


def swung(degrees):
    times = np.arange(180) * STEP
    return PENDULUM.path(np.array([0.4, 0.1, 0.0, np.radians(degrees), 0.0]), times)[:, 0]


def on_an_arc(motion):
    clips = frames_of(motion)
    arc = next(g for g in guesses(clips, False) if g.model.charts[0].name == "arc")
    return race(clips, [(arc.model, arc.values)])[0]


def explained(motion, end):
    """A pendulum as it is told of a recording, whatever else would explain it."""
    fits = [on_an_arc(x) for x in (motion.cut(0, end), motion)]
    begin = motion.times[:, 0]
    few, all_ = (Mechanism((Group((0,), fit),), 0, begin) for fit in fits)
    return ByMechanism(few, few, all_, motion, end, Units())


def quick_mode():
    """Radians per second of a small swing in which the bobs go opposite ways."""
    upper, lower = LENGTHS
    mass = np.array([[(1 + RATIO) * upper, RATIO * lower], [upper, lower]])
    rates = np.linalg.eigvals(np.linalg.solve(mass, GRAVITY * np.diag([1 + RATIO, 1.0])))
    return np.sqrt(rates.max())


@pytest.mark.parametrize("angles", [(8, 14), (20, 20), (35, 50)])
@pytest.mark.parametrize("which", [0, 1])
def test_what_is_left_of_one_bob_of_two_swings_by_itself(which, angles):
    found = own_swing(on_an_arc(filmed(bob(which, angles))))
    assert found is not None
    if max(angles) < 20:
        assert found.rate == pytest.approx(quick_mode(), rel=0.03)


def through_a_lens(path):
    return path * (1 - 0.6 * (path**2).sum(-1, keepdims=True))


def askew(path):
    return view.seen(path, np.array([0.3, -0.2, 0.05]))


def line_by_line(path):
    """Each place as it is a little later the lower it is, as a rolling shutter shows it."""
    later = 0.02 * (path[:, 1] - path[:, 1].max()) / np.ptp(path[:, 1])
    return path - np.gradient(path, STEP, axis=0) * later[:, None]


@pytest.mark.parametrize("camera", [through_a_lens, askew, line_by_line])
@pytest.mark.parametrize("degrees", [15, 70])
def test_what_a_camera_leaves_of_a_swing_does_not(camera, degrees):
    assert own_swing(on_an_arc(filmed(camera(swung(degrees))))) is None


def test_errors_that_last_have_no_rate():
    slow = np.zeros((180, 2))
    random = np.random.default_rng(1)
    for k in range(1, 180):
        slow[k] = 0.85 * slow[k - 1] + random.normal(0, 0.002, 2)
    assert own_swing(on_an_arc(filmed(swung(30) + slow))) is None


def test_one_bob_is_told_as_a_pendulum_with_reserve_only():
    told = explained(filmed(bob(0, (20, 33))), 126)
    assert told.verdict.share > 0.99 and told.verdict.horizon == told.verdict.held_out
    assert told.verdict.status == "mostly explained" and not told.sure
    assert any("is followed would tell" in line for line in told.lines())
    plain = explained(filmed(swung(30)), 126)
    assert plain.verdict.status == "explained"
    assert not any("is followed would tell" in line for line in plain.lines())


# a force that is not quite the law's


def along(power, noise=0.002, frames=300):
    """A table of a body on a line, under a force that goes with a power of the distance."""
    path = BENT_TRAP.path(np.array([6.0, power, 0.1, 0.4]), np.arange(frames) * 0.02)
    return motion_of((path + np.random.default_rng(0).normal(0, noise, path.shape))[None], 0.02)


def trapped(motion):
    clips = frames_of(motion)
    line = [g for g in guesses(clips, False) if g.model.law.restoring == "trap"]
    return max(race(clips, [(g.model, g.values) for g in line]), key=lambda x: x.score)


@pytest.mark.parametrize(
    ("power", "seconds", "alike"),
    [(0.5, 6, True), (1.5, 12, True), (1.5, 6, None), (1.0, 6, False), (1.0, 3, None)],
)
def test_a_force_that_is_no_spring_s_misses_alike_at_every_swing(power, seconds, alike):
    motion = along(power, frames=round(50 * seconds))
    fit, bent = trapped(motion), power != 1
    assert fit.left < 0.15 * fit.spread and alike_every_time(fit) == alike
    found = Mechanism((Group((0,), fit),), 0, motion.times[:, 0])
    told = ByMechanism(found, found, found, motion, round(35 * seconds), Units())
    assert told.verdict.bent == bent
    assert told.verdict.status != "explained" if bent else told.verdict.status == "explained"


def test_noise_that_lasts_bends_no_law():
    motion, random = along(1.0), np.random.default_rng(3)
    slow = np.zeros(300)
    for k in range(1, 300):
        slow[k] = 0.9 * slow[k - 1] + random.normal(0, 0.004)
    assert not alike_every_time(trapped(motion_of(motion.positions + slow[:, None, None], 0.02)))
