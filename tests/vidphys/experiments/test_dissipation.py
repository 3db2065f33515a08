"""Friction by exact flows, dragged gravity, and what is asked where energy leaves."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Generator, Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, build, terms
from dynamics.friction import FLOWS, Friction
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap
from vidphys.errors import InputError
from vidphys.experiments.core import dissipation
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.dissipation import (
    opposed,
    score_divergence,
    score_refusal,
    score_retrace,
    score_shed,
)
from vidphys.experiments.core.question import Question
from vidphys.experiments.friction.drag import DRAG, drag_cell
from vidphys.presets import OracleSizes
from vidphys.scenes import certify
from vidphys.scenes.drag import dragged_gravity
from vidphys.scenes.pendulum import pendulum
from vidphys.summary import Summary

F64 = torch.float64
GAMMA, MASS = 0.7, 2.0


def told(friction: float, episodes: int = 1, bodies: int = 1) -> Parameters:
    amount = torch.full((episodes,), friction, dtype=F64)
    mass = torch.full((episodes, bodies), MASS, dtype=F64)
    return Parameters(torch.ones(episodes).to(F64), mass, scalars={"friction": amount})


def moving(p: list[float]) -> PhaseState:
    momentum = torch.tensor([[p]], dtype=F64)
    return PhaseState(torch.zeros_like(momentum), momentum)


@pytest.mark.parametrize(
    ("law", "left"),
    [
        ("linear", lambda v, t: torch.exp(torch.tensor(-GAMMA * t / MASS))),
        ("square", lambda v, t: 1 / (1 + GAMMA * v * t / MASS)),
    ],
)
def test_a_flow_is_exact_for_any_time(law, left):
    port, state = Friction(law, "known"), moving([3.0, -4.0])
    for time in (0.01, 1.0, 50.0):
        after = port.kick(state, told(GAMMA), time)
        torch.testing.assert_close(after, state.p * left(5.0 / MASS, time))
        halves = PhaseState(state.q, port.kick(state, told(GAMMA), time / 2))
        torch.testing.assert_close(
            port.kick(halves, told(GAMMA), time / 2), after, rtol=1e-14, atol=1e-14
        )


@pytest.mark.parametrize("law", FLOWS)
def test_the_force_is_the_flow_s_beginning(law):
    port, state = Friction(law, "known"), moving([3.0, -4.0])
    slope = (port.kick(state, told(GAMMA), 1e-6) - state.p) / 1e-6
    torch.testing.assert_close(port.force(state.p / MASS, told(GAMMA)), slope, atol=1e-5, rtol=0)


@given(
    st.sampled_from(sorted(FLOWS)),
    st.integers(1, 4),
    st.floats(0, 50),
    st.floats(1e-3, 100),
    st.integers(0, 2**31),
)
def test_no_joints_gain_energy_from_friction_at_any_step(law, joints, gamma, dt, seed):
    rng = Generator().manual_seed(seed)
    root = torch.randn(1, joints, joints, generator=rng, dtype=F64)
    mobility = root @ root.mT + 0.01 * torch.eye(joints, dtype=F64)
    p = 5 * torch.randn(1, joints, generator=rng, dtype=F64)

    def energy(p: Tensor) -> float:
        return float(0.5 * p @ mobility[0] @ p.T)

    after = Friction(law, "known").resist(p, mobility, told(gamma), dt)
    assert energy(after) / energy(p) - 1 < 3e-15


def test_coupled_joints_approach_the_exact_flow_at_second_order():
    mobility = torch.tensor([[[2.0, -1.5], [-1.5, 3.0]]], dtype=F64)
    p, port = torch.tensor([[1.0, -2.0]], dtype=F64), Friction("linear", "known")
    exact = torch.linalg.matrix_exp(-GAMMA * mobility[0]) @ p[0]
    errors = []
    for steps in (8, 16, 32):
        x = p
        for _ in range(steps):
            x = port.resist(x, mobility, told(GAMMA), 1 / steps)
        errors.append(float((x[0] - exact).norm()))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.001)
    assert errors[1] / errors[2] == pytest.approx(4, rel=5e-4)


def test_bodies_are_joints_without_coupling():
    state, params = moving([3.0]), told(GAMMA)
    mobility = torch.full((1, 1, 1), 1 / MASS, dtype=F64)
    for law in FLOWS:
        port = Friction(law, "known")
        alone = port.resist(state.p.flatten(-2), mobility, params, 0.3)
        torch.testing.assert_close(
            alone, port.kick(state, params, 0.3).flatten(-2), rtol=3e-15, atol=3e-15
        )


def test_negative_friction_grows_linearly_forever_and_squared_until_it_is_infinite():
    state, against = moving([3.0, -4.0]), told(-GAMMA)
    grown = Friction("linear", "known").kick(state, against, 2.0)
    torch.testing.assert_close(grown, state.p * torch.exp(torch.tensor(GAMMA * 2 / MASS)))
    port, end = Friction("square", "known"), MASS / (GAMMA * 5.0 / MASS)
    assert torch.isfinite(port.kick(state, against, 0.999 * end)).all()
    assert torch.isinf(port.kick(state, against, 1.001 * end)).all()
    assert torch.isinf(port.kick(state, against, 3 * end)).all()


def test_a_guaranteed_port_refuses_to_inject_and_could_not():
    port, state = Friction("linear", "guaranteed"), moving([3.0])
    port.check(told(0.1))
    with pytest.raises(ValueError, match="told friction = -0.1 < 0"):
        port.check(told(-0.1))
    torch.testing.assert_close(port.kick(state, told(-0.1), 1.0), state.p, rtol=3e-15, atol=3e-15)
    head = build(terms.Hamiltonian(ports=(terms.Drag("linear", "guaranteed"),)), 1, 0.01)
    with pytest.raises(ValueError, match="guaranteed port"):
        head.check(told(-0.1))


def test_what_each_strength_may_be():
    free, positive = Friction("linear", "free"), Friction("linear", "positive")
    for port in (free, positive):
        torch.nn.init.constant_(port.raw, -2.0)
    assert float(free.coefficient(told(1.0))) == -2
    assert float(positive.coefficient(told(1.0))) > 0
    factored = Friction("linear", "factored")
    there, back = (factored.coefficient(told(x)) for x in (0.4, -0.4))
    assert torch.equal(there, -back) and float(there) > 0
    with pytest.raises(ValueError, match="use linear, square"):
        Friction("cubic")
    with pytest.raises(ValueError, match="strength 'firm'"):
        Friction("linear", "firm")


def test_joint_friction_of_a_model_takes_its_energy():
    ports = (terms.Drag("square", "positive"),)
    term = terms.GeneralisedHamiltonian(width=8, integrator="rk4", ports=ports)
    torch.manual_seed(0)
    head = build(term, 2, 0.01, 1).double()
    torch.nn.init.constant_(head.ports[0].raw, -6.0)
    scene = pendulum()
    start, params = scene.sample(4, Generator().manual_seed(0))
    state, before = start, head.energy(start, params)
    with torch.no_grad():
        for _ in range(5):
            state, _ = head.advance(state, params, 0.01)
    velocity, force = head.slopes(start, params)
    pull = force - head.force(start, params)
    torch.testing.assert_close(pull, head.ports[0].force(velocity, params), rtol=1e-14, atol=1e-14)
    assert bool((head.energy(state, params) < before).all())
    # dH/dt is what friction takes, v . pull; over 0.05 s to first order.
    loss = (velocity * pull).sum((1, 2)) * 0.05
    torch.testing.assert_close(head.energy(state, params) - before, loss, atol=0.05, rtol=0.5)


def test_drag_takes_out_what_its_power_says():
    scene = dragged_gravity("strong")
    start, params = scene.sample(4, Generator().manual_seed(1))
    path = scene.simulate(start, params, 200)
    energy = scene.energy(path.states, params)
    speed = path.states.p / params.mass[:, None, :, None]
    power = -params.scalar("friction")[:, None] * speed.square().sum((2, 3))
    spent = torch.trapezoid(power, dx=scene.dt, dim=1)
    # Leapfrog itself swings the energy by some 1e-4 in encounters.
    torch.testing.assert_close(energy[:, -1] - energy[:, 0], spent, atol=1e-4, rtol=1e-4)
    assert certify(scene, path, conserving=False).passed.all()


@pytest.mark.parametrize("law", ["linear", "square"])
def test_the_engine_s_joints_lose_what_their_friction_takes(law):
    scene = pendulum(law, 0.5)
    start, params = scene.sample(4, Generator().manual_seed(1))
    path = scene.simulate(start, params, 100)
    energy = scene.energy(path.states, params)
    speed = path.states.q.diff(dim=1).abs() / scene.dt
    power = -params.scalar("friction")[:, None] * speed.pow(2 if law == "linear" else 3).sum((2, 3))
    spent = power.sum(1) * scene.dt
    torch.testing.assert_close(energy[:, -1] - energy[:, 0], spent, atol=0.0, rtol=5e-3)


def test_unknown_drag_is_named():
    with pytest.raises(InputError, match="weak or strong"):
        dragged_gravity("mild")


class Notes:
    """What a recorder was told."""

    def __init__(self) -> None:
        self.values: dict[str, float | None] = {}

    def add(self, metric, summary, *_) -> None:
        self.values[metric] = summary.value

    def add_value(self, metric, value) -> None:
        self.values[metric] = value

    def add_episodes(self, *_) -> None:
        pass


def question(strength: str = "strong", steps: int = 60) -> Question:
    scene = dragged_gravity(strength)
    start, params = scene.sample(4, Generator().manual_seed(2))
    return Question(scene, start, start, params, steps)


def test_the_law_itself_sheds_at_its_own_rate_and_a_conserving_one_does_not():
    asked, notes = question(), Notes()
    score_shed(notes, asked.scene.law, asked, asked.params, 60, "shed")
    assert notes.values["shed_error"] < 3e-15
    assert notes.values["shed_rate"] < 0
    score_shed(notes, asked.scene.law, asked, opposed(asked.params), 60, "anti_shed")
    assert notes.values["anti_shed_rate"] > 0
    conserving = Hamiltonian(FixedKinetic(), asked.scene.law.potential)
    score_shed(notes, conserving, asked, asked.params, 60, "shed")
    assert abs(notes.values["shed_ratio"]) < 1e-4
    assert score_refusal(notes, asked.scene.law, opposed(asked.params)) is False


@pytest.mark.parametrize("true", [Summary(0.0, "ok", 4, 0), Summary(None, "failed", 4, 1)])
def test_a_rate_over_none_is_neither_a_share_nor_an_error(true, monkeypatch):
    rates = iter([Summary(0.5, "ok", 4, 0), true])
    monkeypatch.setattr(dissipation, "_mean", lambda values: next(rates))
    notes, asked = Notes(), question()
    score_shed(notes, asked.scene.law, asked, asked.params, 10, "shed")
    assert notes.values["shed_rate"] == 0.5
    assert notes.values["shed_ratio"] is notes.values["shed_error"] is None


def test_finer_steps_cover_the_same_time():
    asked = question()
    coarse, fine = Notes(), Notes()
    score_shed(coarse, asked.scene.law, asked, asked.params, 60, "shed")
    score_shed(fine, asked.scene.law, asked, asked.params, 60, "shed", fine=4)
    assert fine.values["shed_ratio"] == pytest.approx(1, abs=1e-4)
    assert fine.values["shed_ratio"] != coarse.values["shed_ratio"]


def test_divergence_of_the_law_is_told_from_the_models():
    scene = pendulum("square", 0.5)
    start, params = scene.sample(3, Generator().manual_seed(0))
    ports = (terms.Drag("square", "factored"),)
    term = terms.GeneralisedHamiltonian(width=8, integrator="rk4", ports=ports)
    notes, head = Notes(), build(term, 2, 0.01, 1)
    torch.nn.init.constant_(head.ports[0].raw, -30.0)  # next to no friction, whatever it is told
    score_divergence(notes, head, Question(scene, start, start, params), 100, 1)
    assert notes.values["true_anti_diverged_share"] == 1
    assert notes.values["anti_diverged_share"] == 0
    assert notes.values["anti_diverged_agreement"] == 0


def test_a_conserving_law_retraces_its_way_and_a_dragged_one_does_not():
    asked, notes = question(steps=400), Notes()
    score_retrace(notes, asked.scene.law, asked)
    assert notes.values["true_retrace_nmse"] > 1e-3
    assert notes.values["retrace_ratio"] == pytest.approx(1, rel=3e-15)
    free = replace(
        asked, scene=replace(asked.scene, law=Hamiltonian(FixedKinetic(), HarmonicTrap(1.0)))
    )
    score_retrace(notes, free.scene.law, free)
    assert notes.values["retrace_nmse"] < 1e-20
    assert notes.values["retrace_match"] == 1


def test_a_drag_cell_leaves_records(monkeypatch):
    monkeypatch.setattr("vidphys.experiments.friction.drag.STEPS", 20)
    task = CellTask("drag", "strong/factored-port", (0,), OracleSizes(32, 4, 64, (5e-3,), 4))
    drag_cell("strong", "factored-port")(task)
    assert "strong/factored-port" in DRAG.cells
    found = {row["metric"] for row in task.recorders[0].rows}
    assert {"shed_error", "true_shed_rate", "anti_shed_error"} <= found
