"""Two systems of four coupled oscillators, coercive at every coupling asked about.

Linear, so that the truth is a sum of cosines and nothing in a comparison is an integrator's doing.
Both rings keep a degenerate pair of modes: there a force with curl pumps energy from first order.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, Rollout
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap, Potential, SumPotential
from dynamics.rolling import first_bad_step
from dynamics.stiffness import QuadraticPotential, Stiffness
from vidphys.errors import InputError
from vidphys.scenes.scene import Sampler, Scene

COORDINATES = 4
CONFINEMENT = 2.5  # stiffness of each coordinate by itself
STRONGEST = 1.5  # largest eigenvalue of C: K = 2.5 I + G C has a spectrum in [1, 4] for |G| <= 1
COUPLING = (0.5, 1.5)
DT = 0.05  # seconds (the study's headline step)
RAIL = 1.5  # world units between the rails that masses are drawn on
GROUNDED = {"coupled": 0.0, "modified": 1.0}  # bonds to the ground, over those of the ring


def oscillators(kind: str = "coupled") -> Scene:
    """Four unit masses on a ring of bonds of strength G; ``modified`` ties each to the ground too.

    Raises:
        InputError: unknown kind.
    """
    if kind not in GROUNDED:
        raise InputError(f"oscillators: unknown kind '{kind}'; use one of {', '.join(GROUNDED)}")
    stiffness = coupling_stiffness(kind)
    parts: list[Potential] = [
        QuadraticPotential(Stiffness(stiffness[None], 0.0)),
        HarmonicTrap(CONFINEMENT),
    ]
    settings = {
        "coordinates": COORDINATES,
        "confinement": CONFINEMENT,
        "coupling": COUPLING,
        "bonds_to_ground": GROUNDED[kind],
        "dt_seconds": DT,
    }
    law = Hamiltonian(FixedKinetic(), SumPotential(parts))
    return OscillatorScene(
        f"oscillators-{kind}",
        law,
        _sampler(),
        COORDINATES,
        DT,
        settings,
        space=1,
        max_drift=1e-9,
        stiffness=stiffness,
    )


def coupling_stiffness(kind: str) -> Tensor:
    """C of a system, ``(4, 4)``: the ring's Laplacian and the ground, largest eigenvalue 1.5."""
    eye = torch.eye(COORDINATES, dtype=torch.float64)
    stiffness = (2 + GROUNDED[kind]) * eye - eye.roll(1, 1) - eye.roll(-1, 1)
    return stiffness * (STRONGEST / torch.linalg.eigvalsh(stiffness)[-1])


def curl_matrix(fraction: float, kind: str) -> Tensor:
    """An antisymmetric stiffness, which no potential has: each coordinate pushes the next one.

    Args:
        fraction: its Frobenius norm over that of C.
        kind: which C.
    """
    shift = torch.eye(COORDINATES, dtype=torch.float64).roll(1, 1)
    push = shift - shift.T
    return push * (fraction * coupling_stiffness(kind).norm() / push.norm())


@dataclass(frozen=True)
class OscillatorScene(Scene):
    """The truth in closed form, by the normal modes of C; with or without drag."""

    stiffness: Tensor = field(default_factory=lambda: torch.zeros(1, 1, dtype=torch.float64))

    def place(self, q: Float[Tensor, "*b 4 1"]) -> Float[Tensor, "*b 4 2"]:
        """Beads on level rails, the first on the lowest."""
        rails = RAIL * (torch.arange(COORDINATES).to(q) - (COORDINATES - 1) / 2).unsqueeze(-1)
        return torch.cat([q, rails.expand_as(q)], -1)

    def simulate(
        self, start: PhaseState, params: Parameters, steps: int, every: int = 1
    ) -> Rollout:
        """The exact solution at every ``every``-th of ``steps`` steps.

        Raises:
            ValueError: a mode that is not confined (K has an eigenvalue <= 0), or that a drag keeps
                from swinging.
        """
        start, params = start.map(torch.Tensor.double), params.map(torch.Tensor.double)
        strength, modes = torch.linalg.eigh(self.stiffness)
        squared = CONFINEMENT + params.coupling[..., None] * strength
        if not bool((squared > 0).all()):
            raise ValueError(f"scene {self.name}: not coercive at a coupling asked for")
        drag = params.scalars.get("friction", torch.zeros_like(params.coupling))
        half = drag[..., None] / 2  # masses are one
        if not bool((squared > half**2).all()):
            raise ValueError(f"scene {self.name}: a mode is overdamped at the drag asked for")
        omega, own = ((squared - x**2).sqrt().unsqueeze(-2) for x in (half, 0 * half))
        half, dt = half.unsqueeze(-2), self.dt * every
        time = torch.arange(steps // every + 1, dtype=torch.float64)[:, None] * dt
        phase, decay = omega * time, torch.exp(-half * time)
        q, p = (x.squeeze(-1).unsqueeze(-2) @ modes for x in (start.q, start.p))
        moved_q = decay * (q * phase.cos() + (p + half * q) / omega * phase.sin())
        pull = q * own * (own / omega) + half * p / omega
        moved_p = decay * (p * phase.cos() - pull * phase.sin())
        states = PhaseState(*((x @ modes.T).unsqueeze(-1) for x in (moved_q, moved_p)))
        return Rollout(states, params, dt, first_bad_step(states))


def _sampler() -> Sampler:
    def sample(n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
        low, high = COUPLING
        shape = (n, COORDINATES, 1)
        q = torch.randn(shape, generator=rng, dtype=torch.float64)
        p = torch.randn(shape, generator=rng, dtype=torch.float64)
        coupling = low + (high - low) * torch.rand(n, generator=rng, dtype=torch.float64)
        mass = torch.ones(n, COORDINATES, dtype=torch.float64)
        return PhaseState(q, p), Parameters(coupling, mass)

    return sample
