"""The second law from video: tracks of drawn clips, what a port learns, what is measured of it."""

import math

import pytest
import torch

from dynamics import Hamiltonian
from dynamics.friction import Friction
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import NoPotential, SoftenedGravity
from vidphys.experiments.confusion.scenes import attracted, drag, total
from vidphys.experiments.confusion.second_law import (
    FREE,
    INTERVAL,
    POSITIVE,
    film,
    imbalance,
    rate_of,
    train_port,
)
from vidphys.experiments.confusion.second_law_questions import compounding, momentum_floor

RATE = 1.5


def exact(rate, potential=None):
    """The true law with a port of this rate."""
    head = Hamiltonian(
        FixedKinetic(), potential or SoftenedGravity(0.3), ports=[Friction("linear", "free")]
    )
    with torch.no_grad():
        head.ports[0].raw.fill_(rate)
    return head


@pytest.fixture(scope="module")
def damped():
    return film(total(attracted, drag(RATE, 1)), 5, 12)


def test_tracks_are_read_back_from_the_pixels(damped):
    assert (damped.seen - damped.truth).norm(dim=-1).median() < 1e-3
    assert not torch.equal(damped.seen, damped.truth)


def test_the_true_law_balances_the_energy_and_a_wrong_rate_does_not(damped):
    windows = damped.truth[:, 4:10]
    assert imbalance(exact(RATE), windows) < 0.1 * imbalance(exact(0.0), windows)


def test_only_the_true_sign_of_the_rate_forecasts_clips_that_run_backwards(damped):
    backwards = damped.truth.flip(1)
    assert momentum_floor(exact(-RATE), backwards) < 0.01 * momentum_floor(exact(0.0), backwards)


def test_without_forces_a_start_error_grows_by_the_rate_alone():
    tracks = torch.randn(4, 3, 3, 2)
    grown = compounding(exact(-RATE, NoPotential()), tracks)
    assert grown == pytest.approx(math.exp(2 * RATE * 8 * INTERVAL), rel=1e-4)


def test_a_port_begins_between_the_two_worlds_and_moves_to_its_own(damped):
    for port in (POSITIVE, FREE):
        assert rate_of(train_port(damped.seen, port, 0, 0)) == pytest.approx(0.69, abs=0.01)
    assert rate_of(train_port(damped.seen, FREE, 6, 0)) > 0.72
