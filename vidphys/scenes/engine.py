"""A double pendulum in MuJoCo: the engine gives trajectories, mass matrix, momenta and energy.

The engine is imported when it is first used, never with this module.
"""

from __future__ import annotations

import copy
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dynamics import Parameters, PhaseState
from vidphys.errors import InputError

EARTH = 9.81  # m/s^2: what a coupling of 1 stands for
ENGINE_STEP = 0.002  # seconds of one RK4 step of the engine
JOINTS = 2
MODEL = f"""
<mujoco>
  <option timestep="{ENGINE_STEP}" integrator="RK4" gravity="0 0 -{EARTH}">
    <flag contact="disable" constraint="disable" autoreset="disable"/>
  </option>
  <worldbody>
    <body>
      <joint type="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="1"/>
      <body pos="0 0 -1">
        <joint type="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
CHUNK = 256  # episodes that the engine keeps all steps of at once
NUDGE = 1e-4  # radians, of central differences


class Engine:
    """The double pendulum's model in MuJoCo and its working memory, made when first used."""

    @cached_property
    def model(self) -> Any:
        """The compiled model."""
        import mujoco

        # An episode that is lost is counted in its record; the engine would write a file about it.
        mujoco.set_mju_user_warning(lambda message: None)
        return mujoco.MjModel.from_xml_string(MODEL)

    @cached_property
    def data(self) -> Any:
        """The working memory."""
        import mujoco

        return mujoco.MjData(self.model)

    def simulate(
        self, start: PhaseState, params: Parameters, friction: str | None, steps: int, every: int
    ) -> PhaseState:
        """States at every ``every``-th of ``steps`` engine steps, ``(b, t, 2, 1)``, start included.

        Args:
            start: joint angles and momenta, ``(b, 2, 1)``, float64.
            params: the coupling (units of 9.81 m/s^2), and the scalar ``friction``, if any.
            friction: ``linear`` (N m s), ``square`` (N m s^2) or ``None``.
            steps, every: engine steps.
        """
        from mujoco import rollout

        q = start.q.squeeze(-1)
        first = torch.cat([torch.zeros(len(q), 1).double(), q, self.velocities(start)], -1).numpy()
        parts = []
        for begin in range(0, len(first), CHUNK):
            chosen = slice(begin, begin + CHUNK)
            models = self._models(params[chosen], friction)
            states, _ = rollout.rollout(models, self.data, first[chosen], nstep=steps)
            whole = np.concatenate([first[chosen, None], states], 1)
            parts.append(whole[:, ::every, 1:])
        path = torch.from_numpy(np.concatenate(parts))
        q, v = path[..., :JOINTS, None], path[..., JOINTS:, None]
        return PhaseState(q, self.momenta(q, v))

    def _models(self, params: Parameters, friction: str | None) -> list[Any]:
        """One engine model for each episode: its gravity and its joints' friction."""
        damping = params.scalar("friction").tolist() if friction else [0.0] * len(params.coupling)
        models = []
        for gravity, amount in zip(params.coupling.tolist(), damping, strict=True):
            own = copy.copy(self.model)
            own.opt.gravity[2] = -EARTH * gravity
            if friction == "linear":
                own.dof_damping[:] = amount
            elif friction == "square":
                if not hasattr(own, "dof_dampingpoly"):
                    raise InputError(
                        f"pendulum: MuJoCo {version('mujoco')} has no squared joint friction; "
                        "install a newer one"
                    )
                own.dof_dampingpoly[:, 0] = amount
            models.append(own)
        return models

    def momenta(
        self, q: Float[Tensor, "*b 2 1"], v: Float[Tensor, "*b 2 1"]
    ) -> Float[Tensor, "*b 2 1"]:
        """Momenta M(q) v by the engine, ``(..., 2, 1)``; NaN where a state is not finite."""
        import mujoco

        return self._each(q, v, lambda x, out: mujoco.mj_mulM(self.model, self.data, out, x))

    def velocities(self, state: PhaseState) -> Float[Tensor, "*b 2"]:
        """dq/dt = M(q)^-1 p by the engine, ``(..., 2)``."""
        import mujoco

        def solve(x: np.ndarray, out: np.ndarray) -> None:
            mujoco.mj_solveM(self.model, self.data, out[None], x[None])

        return self._each(state.q, state.p, solve).squeeze(-1)

    def _each(self, q: Tensor, x: Tensor, act: Any) -> Tensor:
        """A function of the engine's mass matrix on each of many vectors."""
        import mujoco

        angles, vectors = (_rows(y) for y in (q, x))
        results = np.full_like(vectors, np.nan)
        finite = np.isfinite(angles).all(1) & np.isfinite(vectors).all(1)
        for row in np.flatnonzero(finite):
            self.data.qpos[:] = angles[row]
            mujoco.mj_fwdPosition(self.model, self.data)  # M(q) included
            act(vectors[row], results[row])
        return torch.from_numpy(results).reshape(x.shape)

    def energies(self, states: PhaseState) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"]]:
        """Kinetic energy, and potential energy at a coupling of 1; batch shape, joules."""
        v = self.velocities(states).unsqueeze(-1)
        kinetic = 0.5 * (states.p.double() * v).sum((-2, -1))
        return kinetic, self.heights(states.q)

    def heights(self, q: Float[Tensor, "*b 2 1"]) -> Float[Tensor, "*b"]:
        """Potential energy at a coupling of 1, by the engine; joules."""
        import mujoco

        angles = _rows(q)
        found = np.full(len(angles), np.nan)
        for row in np.flatnonzero(np.isfinite(angles).all(1)):
            self.data.qpos[:] = angles[row]
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_energyPos(self.model, self.data)
            found[row] = self.data.energy[0]
        return torch.from_numpy(found).reshape(q.shape[:-2])

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b 2 1"]:
        """dp/dt without friction: the gradient of K - V in q at a fixed velocity, ``(..., 2, 1)``.

        By central differences of the engine's energies, good to about 1e-7.
        """
        v, parts = self.velocities(state).unsqueeze(-1), []
        for unit in torch.eye(JOINTS, dtype=torch.float64).unsqueeze(-1):
            ahead, behind = (state.q.double() + sign * NUDGE * unit for sign in (1, -1))
            kinetic = 0.5 * (v * (self.momenta(ahead, v) - self.momenta(behind, v))).sum((-2, -1))
            height = self.heights(ahead) - self.heights(behind)
            parts.append((kinetic - params.coupling * height) / (2 * NUDGE))
        return torch.stack(parts, -1).unsqueeze(-1)


def _rows(x: Tensor) -> np.ndarray:
    """One contiguous row for each state, which is what the engine reads."""
    return np.ascontiguousarray(x.double().reshape(-1, JOINTS).numpy())
