"""Advice from what was measured: the cheapest that suffices, carried over to the scene."""

import json

import numpy as np
import pytest

from tests.vidphys.diagnose.test_diagnose import STEP, seen
from tests.vidphys.trade.test_trade import point
from vidphys.cli import main
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.noise import Noise
from vidphys.diagnose.recordings.tables import write_tracks
from vidphys.diagnose.telling.advice import suffices
from vidphys.diagnose.telling.sufficient import with_measured
from vidphys.trade.context import SIZES, Context
from vidphys.trade.fronts import rollouts
from vidphys.trade.profile import write_profile

MOTION = motion_of(np.linspace(-1, 1, 40)[None, :, None, None] * np.ones(2), STEP)
SPREAD = float(MOTION.positions.std())


def steps(cost, error, integrator, radians):
    return point(
        cost,
        error,
        front="rollouts",
        error_name="state_error",
        configuration={"integrator": integrator},
        units={"radians": radians},
    )


def look(cost, error, encoder):
    return point(
        cost,
        error,
        front="encoders",
        error_name="probe_nmse",
        configuration={"encoder": encoder},
        units={"tokens": 1.0},
    )


def noise(sigma, step=0.05):
    return Noise(sigma * SPREAD, 3, step, True)


MEASURED = [
    steps(1.0, 0.1, "leapfrog", 0.5),
    steps(3.0, 1e-3, "rk4", 0.3),
    steps(4.0, 1e-4, "kahan_li8", 0.9),
]


@pytest.mark.parametrize(
    "sigma, integrator, radians",
    [(0.2, "leapfrog", 0.5), (2e-3, "rk4", 0.3), (2e-4, "kahan_li8", 0.9)],
)
def test_the_cheapest_integrator_below_the_noise_turns_the_fastest_motion_as_far(
    sigma, integrator, radians
):
    given = with_measured(suffices(20.0, STEP), MOTION, noise(sigma), MEASURED)
    assert given.integrator == integrator and integrator in given.measured[0]
    assert given.dt * 20.0 == pytest.approx(radians)


def test_where_nothing_measured_suffices_the_rule_stays_and_that_is_said():
    rule = suffices(20.0, STEP)
    given = with_measured(rule, MOTION, noise(1e-6), MEASURED)
    assert (given.dt, given.integrator) == (rule.dt, rule.integrator)
    assert "nothing is extrapolated" in given.measured[0]


def test_an_encoder_suffices_that_reads_positions_so_that_speeds_show():
    seen_at = (0.05 / 3 / SPREAD) ** 2  # three times the blur of a difference, in a plane
    points = [look(1.0, 1.5 * seen_at, "coarse"), look(2.0, 0.5 * seen_at, "fine")]
    given = with_measured(suffices(0.0, STEP), MOTION, noise(0.01), [*MEASURED, *points])
    assert len(given.measured) == 1 and "encoder fine" in given.measured[0]


def test_rollouts_are_measured_with_what_their_steps_turn(tmp_path):
    context = Context(SIZES["quick"], 0, "cpu", None, tmp_path)
    jobs = list(rollouts.jobs(context))
    per_second = {round(j.units["radians"] / j.configuration["dt"], 6) for j in jobs}
    assert len(per_second) == 1 and 5 < per_second.pop() < 100


@pytest.mark.slow
def test_the_verb_takes_what_was_measured_and_refuses_what_is_not_there(tmp_path, capsys):
    tracks, profile, out = tmp_path / "tracks.csv", tmp_path / "profile.json", tmp_path / "out"
    write_tracks(tracks, seen("trap", 0.002, 1, clips=1, frames=60))
    write_profile(profile, {}, MEASURED)
    command = ["diagnose", str(tracks), "--quiet", "--out", str(out)]
    assert main([*command, "--trade", str(profile)]) == 0
    advice = json.loads((out / "diagnosis.json").read_text())["advice"]
    assert advice["integrator"] in advice["measured"][0]
    assert main([*command, "--trade", str(tmp_path / "none")]) == 2
    assert "nothing was measured there" in capsys.readouterr().err
