"""The engine's double pendulum, free or with friction in its joints.

The study gives no geometry, range or step: two 1 m links of 1 kg, step 0.01 s. The coupling is
gravity in units of 9.81 m/s^2; a negative one lets the pendulum fall upwards. Angles start
anywhere on the circle, because an inverted law leads there: what is asked of a model is then
another law, not also unseen places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dynamics import Friction, Parameters, PhaseState, Rollout
from dynamics.rolling import first_bad_step
from vidphys.errors import InputError
from vidphys.scenes.draws import Range, normal, uniform
from vidphys.scenes.engine import ENGINE_STEP, JOINTS, Engine
from vidphys.scenes.scene import Sampler, Scene

DT = 0.01  # seconds
SUBSTEPS = round(DT / ENGINE_STEP)
GRAVITY: Range = (0.5, 1.5)  # of 9.81 m/s^2 (5 to 15 m/s^2)
WARMTH = 4.0  # joules: momenta start as in a gas of this temperature, p ~ N(0, WARMTH M(q))
FRICTION = {"linear": 0.5, "square": 0.2}  # N m s and N m s^2
DRIFT = 1e-5  # of a certified reference without friction
HALF_EXTENT = 2.5  # metres: both links and the disk at their end


@dataclass(frozen=True)
class EngineLaw:
    """Energy and force of the double pendulum, by the engine."""

    engine: Engine

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        kinetic, height = self.engine.energies(state)
        return kinetic + params.coupling * height

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return self.engine.force(state, params)


@dataclass(frozen=True)
class Pendulum(Scene):
    """A scene whose truth is the engine's.

    Args:
        friction: ``linear``, ``square`` or ``None``.
        engine: that the law asks too.
    """

    friction: str | None = None
    engine: Engine = field(default_factory=Engine)

    @property
    def conserves(self) -> bool:
        return self.friction is None

    def place(self, q: Float[Tensor, "*b 2 1"]) -> Float[Tensor, "*b 2 2"]:
        """The lower ends of both links, with the upper joint in the picture's middle."""
        turned = q.cumsum(-2)  # the lower joint's angle is counted from the upper link
        return torch.cat([-turned.sin(), -turned.cos()], -1).cumsum(-2)

    def derivatives(self, states: PhaseState, params: Parameters) -> PhaseState:
        """The joints' rates, and the torques on their momenta, by the engine."""
        rates = self.engine.velocities(states).unsqueeze(-1)
        torques = self.law.force(states, params)
        if self.friction is not None:
            torques = torques + Friction(self.friction, "known").force(rates, params)
        return PhaseState(rates, torques)

    def simulate(
        self, start: PhaseState, params: Parameters, steps: int, every: int = 1
    ) -> Rollout:
        start, params = start.map(torch.Tensor.double), params.map(torch.Tensor.double)
        fine = steps * SUBSTEPS, every * SUBSTEPS
        states = self.engine.simulate(start, params, self.friction, *fine)
        return Rollout(states, params, self.dt * every, first_bad_step(states))

    def straight_lines(
        self, start: PhaseState, params: Parameters, steps: int, every: int
    ) -> Rollout:
        """Without weight: the motion that inertia alone gives."""
        return self.simulate(start, params.with_coupling(0.0), steps, every)


def pendulum(friction: str | None = None, spread: float = 0.0) -> Scene:
    """The double pendulum.

    Args:
        friction: ``linear`` (a torque against the joint's rate), ``square`` (against its square),
            or ``None``.
        spread: half-width of the friction's range, as a share of its usual value; 0 keeps it
            the same in every episode, and then no model is told it.

    Raises:
        InputError: unknown friction.

    Example:
        >>> from vidphys.scenes import certify
        >>> scene = pendulum()
        >>> start, law = scene.sample(2, Generator().manual_seed(0))
        >>> truth = scene.simulate(start, law, steps=5)  # by the engine
        >>> bool(certify(scene, truth).passed.all())
        True
    """
    if friction is not None and friction not in FRICTION:
        raise InputError(f"pendulum: unknown friction '{friction}'; use linear or square")
    settings = {
        "gravity": GRAVITY,
        "warmth_joules": WARMTH,
        "friction": friction,
        "coefficient": FRICTION.get(friction or "", 0.0),
        "spread": spread,
        "dt_seconds": DT,
        "engine_step_seconds": ENGINE_STEP,
    }
    engine = Engine()
    name = "pendulum" if friction is None else f"pendulum-{friction}"
    return Pendulum(
        name,
        EngineLaw(engine),
        _sampler(engine, friction, spread),
        JOINTS,
        DT,
        settings,
        space=1,
        max_drift=DRIFT,
        half_extent=HALF_EXTENT,
        friction=friction,
        engine=engine,
    )


def _sampler(engine: Engine, friction: str | None, spread: float) -> Sampler:
    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        shape = (n, JOINTS, 1)
        q = uniform(shape, (-math.pi, math.pi), rng)
        # p = L z with M = L L^T is the gas; its rows by the engine's M, one unit vector each.
        units = torch.eye(JOINTS, dtype=torch.float64)
        columns = [engine.momenta(q, unit.unsqueeze(-1).expand(shape)) for unit in units]
        factor = torch.linalg.cholesky(torch.cat(columns, -1))
        p = factor @ normal(shape, math.sqrt(WARMTH), rng)
        params = Parameters(uniform((n,), GRAVITY, rng), torch.ones(n, JOINTS).double())
        if friction is not None:
            usual = FRICTION[friction]
            around = (usual * (1 - spread), usual * (1 + spread))
            params = params.with_scalar("friction", uniform((n,), around, rng))
        return PhaseState(q, p), params

    return sample
