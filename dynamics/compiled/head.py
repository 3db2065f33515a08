"""From a trained model to one that rolls fast: a spline for its pair function, fused steps."""

from __future__ import annotations

import copy
import os
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, NamedTuple, cast

import torch
from torch import Tensor

from dynamics.compiled.build import Report, pair_spline
from dynamics.compiled.spline import PairSpline
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head, Trajectory
from dynamics.integrators import YOSHIDA_WEIGHTS, leapfrog, yoshida4
from dynamics.kinetic import FixedKinetic
from dynamics.mlp import TANH
from dynamics.pairs import pair_indices
from dynamics.potentials import DisplacementPotential, PairPotential, RadialPotential
from dynamics.state import Parameters, PhaseState

Backend = Literal["torch", "numba", "triton"]
PARTS = {leapfrog.name: (1.0,), yoshida4.name: YOSHIDA_WEIGHTS}  # of a step, each a leapfrog step
# Triton holds all pairs of an episode in registers, numba those of a block of them in memory.
# Loops with a way back keep what the network gave of every pair at every step.
MOST_BODIES = {"triton": 8, "numba": 128, "unrolled": 8}
REACH = 1000.0  # world units


class CompiledHead(Hamiltonian):
    """A Hamiltonian model whose pair function is a spline or a frozen network, rolled fused.

    It is what :func:`compile_head` makes. Stepped one by one, or where its close encounters need
    shorter steps, it runs in plain torch, the twin of the fused loops.

    Attributes:
        report: what the spline was built for and what it reached; ``None`` for a network.
        backend: what :meth:`trajectory` runs on; ``None`` for the best at hand.
    """

    def __init__(
        self, head: Hamiltonian, potential: Any, report: Report | None, backend: Backend | None
    ) -> None:
        parts = copy.deepcopy([head.kinetic, *head.ports])
        super().__init__(parts[0], potential, head.integrator, parts[1:])
        self.domain = head.domain.clone()
        self.report, self.backend = report, backend
        self._packed: dict[Any, tuple[Backend, Any]] = {}

    def trajectory(
        self, start: PhaseState, params: Parameters, steps: int, dt: float, every: int = 1
    ) -> Trajectory:
        """All steps, by the backend.

        Raises:
            ValueError: the backend cannot run this model here; why is said.
        """
        name, packed = self._ready(start.q)
        if name == "torch" or not start.q.numel() or start.q.shape[-2] < 2:
            return self._plain(start, params, steps, dt, every)
        found = fused(self, start, params, steps, dt, every, name, packed)
        if found.fallbacks and name == "triton":  # its kernel has no network
            return self._plain(start, params, steps, dt, every)
        return found

    def _ready(self, states: Tensor) -> tuple[Backend, Any]:
        """The backend for such states and the pair function as it takes it, found once."""
        key = self.backend, states.dtype, states.device, states.shape[-2:]
        if key not in self._packed:
            name = self.backend or best(self, states)
            if trouble := refusal(self, name, states):
                raise ValueError(f"compiled model: backend '{name}' {trouble}")
            packed = None if name == "torch" else kernels_of(name).packed(self.potential, states)
            self._packed[key] = name, packed
        return self._packed[key]

    def _plain(
        self, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
    ) -> Trajectory:
        spline = self.potential if isinstance(self.potential, PairSpline) else None
        before = spline.outside if spline else 0
        found = Head.trajectory(self, start, params, steps, dt, every)
        asked = spline.outside - before if spline else 0
        return Trajectory(found.states, "torch", asked)


@lru_cache
def kernels_of(backend: str) -> Any:
    """The fused loops of a backend."""
    return import_module("dynamics.compiled." + ("cpu" if backend == "numba" else "cuda"))


def fused(
    head: Hamiltonian,
    start: PhaseState,
    params: Parameters,
    steps: int,
    dt: float,
    every: int,
    backend: str = "numba",
    packed: Any = None,
) -> Trajectory:
    """All steps of a model with one pair law, which :func:`refusal` has nothing against.

    Args:
        head, start, params, steps, dt, every: see :meth:`dynamics.head.Head.trajectory`.
        backend: ``numba`` or ``triton``.
        packed: the pair function as the backend takes it, where it was packed before.
    """
    kernels, potential = kernels_of(backend), cast(PairPotential, head.potential)
    batch, sizes = start.q.shape[:-2], start.q.shape[-2:]
    strength, amount = potential.law.strength(params)
    q, p, asked, reached = kernels.roll(
        kernels.packed(potential, start.q) if packed is None else packed,
        potential.law.box,
        Episodes(
            flat(start.q, batch, *sizes),
            flat(start.p, batch, *sizes),
            flat(params.mass, batch, sizes[0]),
            flat(strength, batch),
            flat(amount, batch, sizes[0]),
        ),
        [part * dt for part in PARTS[head.integrator.name]],
        steps // every,
        every,
    )
    if len(batch) != 1:
        q, p = (x.reshape(*batch, *x.shape[1:]) for x in (q, p))
    return Trajectory(PhaseState(q, p), backend, asked, reached)


def flat(x: Tensor, batch: torch.Size, *sizes: int) -> Tensor:
    """``x`` of every episode of a batch, along one axis: ``(episodes, *sizes)``."""
    if len(batch) == 1 and x.shape == (*batch, *sizes) and not x.requires_grad:
        return x
    return x.expand((*batch, *sizes)).reshape(-1, *sizes)


class Episodes(NamedTuple):
    """What a backend rolls, episodes along one axis.

    Args:
        q, p: ``(episodes, bodies, 2)``.
        mass: ``(episodes, bodies)``.
        strength: c(G), ``(episodes,)``.
        amount: s_i, ``(episodes, bodies)``.
    """

    q: Tensor
    p: Tensor
    mass: Tensor
    strength: Tensor
    amount: Tensor


def unrolled(
    head: Hamiltonian, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> Trajectory:
    """All steps of a :func:`trainable` model, with a way back; see :func:`fused`."""
    from dynamics.compiled import unrolled_orbits

    potential = cast(DisplacementPotential, head.potential)
    batch, sizes = start.q.shape[:-2], start.q.shape[-2:]
    mass, strength = episodes_last(potential.law, params, batch)
    told = torch.cat([1 / mass, strength]).T
    states = unrolled_orbits.unrolled(
        potential, start.flat.reshape(batch.numel(), -1), told, steps // every, every, dt
    )
    flat = states.reshape(*batch, *states.shape[1:])
    return Trajectory(PhaseState.from_flat(flat, *sizes), "numba")


def trainable(head: Hamiltonian, states: Tensor) -> bool:
    """Whether loops with a way back know a model: leapfrog and one law of displacements."""
    law = head.potential
    if not isinstance(law, DisplacementPotential) or law.law.box is not None:
        return False
    *hidden, _ = (layer.out_features for layer in law.phi.layers)
    known = law.phi.activation == TANH and len(hidden) == 2 and hidden[0] == hidden[1]
    bodies = 2 <= states.shape[-2] <= MOST_BODIES["unrolled"]
    plain = head.integrator == leapfrog and refusal(head, "numba", states) is None
    return known and bodies and plain


def episodes_last(law: Any, params: Parameters, batch: torch.Size) -> tuple[Tensor, Tensor]:
    """Masses ``(n, episodes)`` and c(G) s_i s_j ``(pairs, episodes)`` of a batch of episodes."""
    strength, amount = law.strength(params)
    i, j = pair_indices(params.mass.shape[-1], params.mass.device)
    # By select: an index wakes torch's threads, which then spin where the loops' own want to run.
    product = strength.unsqueeze(-1) * (amount.index_select(-1, i) * amount.index_select(-1, j))
    wide = (x.expand(*batch, x.shape[-1]).reshape(-1, x.shape[-1]) for x in (params.mass, product))
    mass, product = (x.T.contiguous() for x in wide)
    return mass, product


def compile_head(
    head: Head,
    tolerance: float | None = 1e-4,
    reach: float = REACH,
    backend: Backend | None = None,
) -> CompiledHead:
    """A trained model in a form that rolls fast, with frozen copies of all that it has learned.

    Args:
        head: a Hamiltonian whose potential is one learned pair law (``factored``,
            ``factored-radial``, ``factored-learned-kinetic``).
        tolerance: of the pair force, relative to the float64 network's, see
            :class:`dynamics.compiled.build.Sample`; ``None`` keeps the network itself. In single
            precision a trained network of displacements errs by nearly 1e-4 itself.
        reach: world units; pairs that are farther apart are left to the network.
        backend: ``torch``, ``numba`` (CPU) or ``triton`` (CUDA); ``None`` for the best that runs
            the model where its states lie.

    Raises:
        ValueError: the model has no such pair law, the tolerance cannot be met, or the backend
            cannot run the model.
    """
    if not isinstance(head, Hamiltonian) or not isinstance(head.potential, _COMPILED):
        what = type(getattr(head, "potential", head)).__name__
        raise ValueError(
            f"compile_head: {what} is no function of one displacement: only a learned pair law "
            "(displacement or radial) by itself can be compiled; roll this model as it is"
        )
    phi = head.potential
    if isinstance(phi, DisplacementPotential) and phi.phi.layers[0].in_features != 2:
        raise ValueError("compile_head: a law of displacements is compiled in a plane only")
    report = None
    if tolerance is None:
        potential: Any = copy.deepcopy(phi).requires_grad_(False)
    else:
        potential, report = pair_spline(phi, tolerance, reach)
    compiled = CompiledHead(head, potential, report, backend).requires_grad_(False)
    example = torch.empty(1, 2, 2, device=next(phi.parameters()).device)
    if backend is not None and (trouble := refusal(compiled, backend, example)):
        raise ValueError(f"compile_head: backend '{backend}' {trouble}")
    return compiled


_COMPILED = (DisplacementPotential, RadialPotential)


def refusal(head: Hamiltonian, backend: str, states: Tensor) -> str | None:
    """Why a backend cannot roll a model from positions ``(..., n, d)``; ``None`` where it can."""
    if backend == "torch":
        return None
    if backend not in ("numba", "triton"):
        return "is unknown; use torch, numba or triton"
    if not isinstance(head.kinetic, FixedKinetic) or len(head.ports):
        return "rolls |p|^2 / 2m and a pair law, with no ports and no learned kinetic energy"
    if not isinstance(head.potential, (PairSpline, *_COMPILED)):
        return "rolls one learned pair law, displacement or radial"
    if head.integrator.name not in PARTS:
        return f"has no {head.integrator.name}; it has {', '.join(PARTS)}"
    bodies, space = states.shape[-2:]
    if space != 2:
        return f"rolls bodies in a plane, these are in {space} dimensions"
    if backend == "triton" and not isinstance(head.potential, PairSpline):
        return "evaluates splines only; give a tolerance"
    most = MOST_BODIES[backend]
    if bodies > most:
        return f"holds at most {most} bodies, got {bodies}"
    wanted = "cpu" if backend == "numba" else "cuda"
    if states.device.type != wanted and not (backend == "triton" and interpreted()):
        return f"needs states on {wanted}, these are on {states.device.type}"
    if not installed(backend):
        return f"is not installed; install {backend}"
    return None


@lru_cache
def installed(package: str) -> bool:
    """Whether a package can be imported."""
    return find_spec(package) is not None


def best(head: CompiledHead, states: Tensor) -> Backend:
    """The fastest backend that can roll a model from some positions."""
    fastest: Backend = "triton" if states.device.type == "cuda" else "numba"
    return "torch" if refusal(head, fastest, states) else fastest


def interpreted() -> bool:
    """Whether Triton kernels run in its interpreter, on the CPU, which tests use."""
    return os.environ.get("TRITON_INTERPRET") == "1"
