"""Training a diagnosed scene's model: it starts at the numbers found, whatever the units."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dynamics import build, from_config, terms
from dynamics.fields import UniformField
from dynamics.friction import Friction
from tests.shared.bouncing import thrown
from vidphys.diagnose.explanations.specification import as_specification
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer
from vidphys.errors import InputError
from vidphys.reading.fitted import Units, even
from vidphys.reading.laws import Law
from vidphys.reading.numbers import numbers_of
from vidphys.reading.specified import train_specified


def test_units_are_the_spread_and_the_time_to_cross_it():
    times = np.arange(50) * 0.1
    motion = motion_of(3.0 * times[None, :, None, None], 0.1)
    units = Units.of(motion)
    assert units.length == pytest.approx(3.0 * times.std())
    assert units.length / units.seconds == pytest.approx(3.0)
    swing = terms.Walled(terms.Hamiltonian(potentials=(terms.Trap(4.0),)), 6.0, 0.9, (1.0,))
    term = swing.counted_in(units.length, units.seconds)
    assert term.free.potentials[0].stiffness == pytest.approx(4.0 * units.seconds**2)
    assert (term.place, term.restitution) == pytest.approx((6.0 / units.length, 0.9))


@pytest.mark.parametrize("law", ["linear", "square", "dry"])
@pytest.mark.parametrize("strength", ["positive", "free"])
@pytest.mark.parametrize("rate", [3e-4, 0.3, 300.0])
def test_training_starts_at_the_numbers_found(law, strength, rate):
    term = terms.Hamiltonian(potentials=(terms.Uniform(),), ports=(terms.Drag(law, strength),))
    numbers = {"uniform: x": (0.0, 1.0), "uniform: y": (-9.8, 0.1), f"{law}: rate": (rate, 0.1)}
    started = from_config(as_specification(term, 1, (0, 0), numbers, True, 0.1)["terms"])
    head = build(started.counted_in(length=2.0, seconds=5.0), 1, 0.01, 2)
    (field,) = (part for part in head.modules() if isinstance(part, UniformField))
    (port,) = (part for part in head.modules() if isinstance(part, Friction))
    assert field.acceleration.tolist() == pytest.approx([0.0, -9.8 * 25 / 2])
    # a rate counts per time, per length, or as an acceleration
    size = {"linear": 5.0, "square": 2.0, "dry": 25 / 2}[law]
    told = torch.nn.functional.softplus(port.raw) if strength == "positive" else port.raw
    assert told.item() == pytest.approx(rate * size, rel=1e-4)


def test_a_bouncing_ball_is_foretold_as_well_in_pixels_and_milliseconds():
    errors = []
    for unit, second in ((1.0, 1.0), (300.0, 1e3)):
        motion = thrown(unit=unit, second=second)
        found = answer(motion, False, 0.3).specification
        trained = train_specified(from_config(found["terms"]), found, motion, 84, 6, 0)
        errors.append(trained.error / unit)
        assert trained.error < 0.2 * trained.still
    assert errors[1] == pytest.approx(errors[0], rel=0.05)


def test_frames_at_uneven_times_train_the_same_model():
    motion = thrown()
    found = answer(motion, False, 0.3).specification
    term = from_config(found["terms"])
    even = train_specified(term, found, motion, 84, 6, 0)
    kept = np.delete(np.arange(motion.positions.shape[1]), [20, 33, 34, 57])
    fewer = replace(motion, positions=motion.positions[:, kept], times=motion.times[:, kept])
    trained = train_specified(term, found, fewer, 80, 6, 0)
    assert trained.still == pytest.approx(even.still, rel=0.02)
    assert trained.error < 0.2 * trained.still


def test_standing_still_is_where_a_body_was_last_seen():
    motion = thrown()
    found = answer(motion, False, 0.3).specification
    shown = motion.positions[0, 81].copy()
    motion.positions[0, 82:84] = np.nan
    trained = train_specified(from_config(found["terms"]), found, motion, 84, 1, 0)
    away = np.linalg.norm(motion.positions[0, 84:] - shown, axis=-1)
    assert trained.still == pytest.approx(np.sqrt((away**2).mean()), rel=1e-4)


def test_what_drives_a_swing_goes_by_the_recordings_own_time():
    """The swing and the drive are those of a closed form; the recording begins at 7.3 s."""
    times = 7.3 + 0.05 * np.arange(300)
    path = np.cos(3.1 * times + 0.4) + 0.8 * np.sin(2.0 * times)  # (4 - 3.1^2) cos drives it
    motion = motion_of(3.0 * path[None, :, None, None], 0.05)
    motion = replace(motion, times=times[None])
    push = 3.0 * (4.0 - 3.1**2)
    motor = terms.Sinusoid((0.9 * push * np.cos(0.4),), (-0.9 * push * np.sin(0.4),), 3.09)
    term = terms.Clocked(terms.Hamiltonian(potentials=(terms.Trap(4.0),)), (motor,))
    held = as_specification(term, 1, (0.0,), {}, True, 0.05)
    trained = train_specified(term, held, motion, 210, 20, 0)
    assert trained.error < 0.02 < 1.0 < trained.still
    found = numbers_of(trained.model)
    assert found["forcing"] == pytest.approx(abs(push), rel=0.01)
    assert found["forcing_rate"] == pytest.approx(3.1, rel=1e-3)
    assert Law(trained.model.head, trained.model.params).quantities == [
        "stiffness",
        "forcing",
        "mass",
    ]
    start, law = trained.model.last(motion), trained.model.under({"forcing": 0.0}).law(motion)
    alone = trained.model.under({"forcing": 0.0}).roll(start, times[-1], 100, 0.05, law).positions
    place, speed = (
        3.0 * path[-1],
        3.0 * (1.6 * np.cos(2 * times[-1]) - 3.1 * np.sin(3.1 * times[-1] + 0.4)),
    )
    since = 0.05 * np.arange(101)
    expected = place * np.cos(2 * since) + speed / 2 * np.sin(2 * since)
    assert np.abs(alone[:, 0, 0] - expected).max() < 0.05


def test_each_trial_of_a_driven_swing_has_its_own_time():
    """Two trials of the motor alone, the second half a period later."""
    times = 0.05 * np.arange(200) + np.array([[0.0], [np.pi / 2.0]])
    motion = motion_of(np.sin(2.0 * times)[..., None, None], 0.05)
    motor = terms.Sinusoid((0.0,), (-3.0,), 2.0)
    still = terms.Hamiltonian(potentials=(terms.NoPotential(),))
    term = terms.Clocked(still, (motor,))
    held = as_specification(term, 1, (0.0,), {}, True, 0.05)
    motion = replace(motion, times=times)
    trained = train_specified(term, held, motion, 140, 20, 0)
    assert trained.error < 0.05 < 0.5 < trained.still
    assert numbers_of(trained.model)["forcing"] == pytest.approx(4.0, rel=0.02)


def test_a_network_beside_a_law_that_changes_with_time_is_refused():
    times = 0.05 * np.arange(100)
    motion = motion_of(np.sin(2.0 * times)[None, :, None, None], 0.05)
    free = terms.Hamiltonian(potentials=(terms.FreePotential(),))
    term = terms.Clocked(free, (terms.Sinusoid((0.0,), (1.0,), 2.0),))
    held = as_specification(term, 1, (0.0,), {}, True, 0.05)
    with pytest.raises(InputError, match="changes with time and another is a network"):
        train_specified(term, held, motion, 70, 5, 0)


def test_stamps_that_are_rounded_do_not_make_a_second_shorter():
    times = np.arange(300)[None] / 30
    motion = motion_of(np.sin(2.0 * times)[..., None, None], 1 / 30)
    rounded = even(replace(motion, times=times.round(3)))
    assert rounded.interval == pytest.approx(0.033)
    path = np.sin(2.0 * rounded.times[0])
    assert np.nanmax(np.abs(rounded.positions[0, :, 0, 0] - path)) < 5e-3
    since = rounded.times[0, -1] - rounded.times[0, 0]
    assert since == pytest.approx(299 / 30, abs=0.05) and len(path) > 300
