"""A drive against the friction: the exact steady state, and what has none."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from dynamics import Hamiltonian, rollout
from dynamics.bath import (
    ConstantBath,
    DrivenBath,
    ExactBath,
    NoSteadyState,
    relaxation_time,
    steady_temperature,
)
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap
from tests.vidphys.experiments.test_thermostat import TINY, ask_briefly, bath_params, made, momenta
from vidphys.errors import InputError
from vidphys.experiments.core.bars import ABSENT, judge, rows_of
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.heat import bath as training
from vidphys.experiments.heat import drive, temperature
from vidphys.runs.records import merged_tables
from vidphys.scenes.langevin import driven


@settings(max_examples=50, deadline=None)
@given(st.floats(0.1, 5.0), st.floats(-3.0, 0.95), st.floats(0.1, 3.0), st.floats(0.01, 5.0))
def test_the_step_has_the_driven_steady_state(friction, share, heat, dt):
    """P5: momentum variance m T friction / (friction - drive), at any step."""
    params = bath_params(1, friction, heat, drive=share * friction)
    decay, variance = ExactBath().moments(params, dt)
    expected = params.mass.unsqueeze(-1) * steady_temperature(params)[:, None, None]
    torch.testing.assert_close(variance / (1 - decay.square()), expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("strength", [-1.0, 0.5, 1.4])
def test_the_simulator_comes_to_it_among_attracting_bodies(strength):
    scene = driven()
    setting = {"friction": 2.0, "temperature": 1.0, "drive": strength}
    crowd = temperature.walkers(scene, [setting], 128, 0)
    (found,), _ = temperature.temperatures(scene.exact, scene, crowd, 0)
    expected = float(steady_temperature(crowd.params)[0])
    assert found.value == pytest.approx(expected, abs=4 * found.error)
    assert found.error < 0.015 * expected


def test_equal_drive_and_friction_spread_without_bound():
    """The limit of no net damping is a random walk: variance 2 m T friction t."""
    params = bath_params(1, 2.0, 0.7, drive=2.0)
    decay, variance = ExactBath().moments(params, 3.0)
    assert float(decay.max()) == 1
    expected = params.mass.unsqueeze(-1) * 2 * 0.7 * 2.0 * 3.0
    torch.testing.assert_close(variance, expected, rtol=3e-15, atol=3e-15)


@pytest.mark.parametrize("strength", [2.0, 2.5])
def test_no_steady_state_is_refused_and_said_by_name(strength):
    params = bath_params(2, 2.0, 1.0, drive=strength)
    with pytest.raises(ValueError, match="no steady state"):
        steady_temperature(params)
    law = Hamiltonian(FixedKinetic(), HarmonicTrap(1.0), ports=[ExactBath()])
    with pytest.warns(NoSteadyState, match="no steady state"):
        rollout(law, momenta(2), params, 2, 0.05)
    assert temperature.flags(law, params)
    assert not temperature.flags(law, params.with_scalar("drive", 1.9))


def test_a_learned_drive_is_judged_by_its_own_damping():
    bath = made(DrivenBath)
    law = Hamiltonian(FixedKinetic(), HarmonicTrap(1.0), ports=[bath])
    params = bath_params(1, 2.0, 1.0, drive=0.0)
    weight = bath.drive(params.with_scalar("drive", 1.0)).item()
    limit = bath.friction(params).item() / weight
    assert temperature.flags(law, params.with_scalar("drive", 1.01 * limit))
    assert not temperature.flags(law, params.with_scalar("drive", 0.99 * limit))


def test_the_control_does_not_see_the_drive():
    bath = made(ConstantBath)
    one, two = (bath.moments(bath_params(1, 2.0, 1.0, drive=a), 0.1) for a in (-1.0, 1.4))
    assert torch.equal(one[0], two[0])
    assert torch.equal(one[1], two[1])


def test_the_drives_weight_is_found_from_all_steps():
    scene = driven()
    seen = training.bath_trajectory(scene, 128, 0, 128 * 600)
    head = Hamiltonian(FixedKinetic(), scene.exact.potential, ports=[DrivenBath(3, 2)])
    training.refine(head, seen)
    params = bath_params(1, 2.0, 1.0, drive=1.0).map(Tensor.float)
    bath = training.bath_of(head)
    assert bath.friction(params).item() == pytest.approx(2.0, rel=0.01)
    assert bath.drive(params).item() == pytest.approx(1.0, rel=0.08)


@pytest.mark.parametrize("drives", [(), (0.0, 2.0)])
def test_a_scene_refuses_drives_that_have_no_steady_state(drives):
    with pytest.raises(InputError, match="driven"):
        driven(drives)


@pytest.mark.slow
def test_every_row_of_the_tables_finds_its_number(monkeypatch):
    ask_briefly(monkeypatch)
    recorders = []
    for name, cell in drive.DRIVE.cells.items():
        task = CellTask("drive", name, (0,), TINY)
        cell(task)
        recorders += task.recorders
    records = merged_tables(recorders)[0].to_pylist()
    for table in (drive.DRIVE, drive.NO_STEADY_STATE):
        for row in rows_of(table.name):
            assert judge(row, records).verdict != ABSENT, row
    simulator = {r["metric"]: r["value"] for r in records if r["cell"] == "simulator"}
    assert simulator["diverged_fraction"] == simulator["flagged_fraction"] == 1
    control = {r["metric"]: r["value"] for r in records if r["cell"] == "control"}
    assert control["diverged_fraction"] == control["flagged_fraction"] == 0


def test_a_driven_bath_forgets_its_start_in_its_relaxation_time():
    told = bath_params(2, 2.0, 1.0, drive=1.5)
    assert relaxation_time(told).tolist() == [2.0, 2.0]
    assert relaxation_time(bath_params(2, 2.0, 1.0, drive=2.0)).isinf().all()
    assert relaxation_time(bath_params(2, 4.0, 1.0)).tolist() == [0.25, 0.25]
