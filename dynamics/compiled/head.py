"""From a trained model to one that rolls fast: a spline for its pair function, fused steps."""

from __future__ import annotations

import copy
import os
from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

from dynamics.compiled.build import pair_spline
from dynamics.compiled.spline import PairSpline
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head, Report, Trajectory
from dynamics.integrators import YOSHIDA_WEIGHTS, leapfrog, yoshida4
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import DisplacementPotential, RadialPotential
from dynamics.state import Parameters, PhaseState
from loops import has_numba, has_triton

Backend = Literal["torch", "numba", "triton"]
PARTS = {leapfrog.name: (1.0,), yoshida4.name: YOSHIDA_WEIGHTS}  # of a step, each a leapfrog step
# Triton holds all pairs of an episode in registers, numba those of a block of them in memory.
MOST_BODIES = {"triton": 8, "numba": 128}
FEW_BODIES = 5
WIDEST = 512, 256  # units of a network that Triton has room for: with so few bodies, and with more
REACH = 1000.0  # world units


class CompiledHead(Hamiltonian):
    """A Hamiltonian model whose pair function is a spline or a frozen network, rolled fused.

    It is what :func:`compile_head` makes. Stepped one by one, or where its close encounters need
    shorter steps, it runs in plain torch, the twin of the fused loops.

    Attributes:
        report: what the spline was built for and what it reached; ``None`` for a network.
        backend: what :meth:`trajectory` runs on; ``None`` for the best at hand.
        packed: of kinds of states, what they run on and the pair function as that takes it.
    """

    def __init__(
        self, head: Hamiltonian, potential: Any, report: Report | None, backend: Backend | None
    ) -> None:
        parts = copy.deepcopy([head.kinetic, *head.ports])
        super().__init__(parts[0], potential, head.integrator, parts[1:])
        self.domain = head.domain.clone()
        self.report, self.backend = report, backend
        self.packed: dict[Any, tuple[Backend, Any]] = {}

    def plain_trajectory(
        self, start: PhaseState, params: Parameters, steps: int, dt: float, every: int = 1
    ) -> Trajectory:
        """The same by torch's own operations; pairs beyond a spline's reach are counted."""
        spline = self.potential if isinstance(self.potential, PairSpline) else None
        before = spline.outside if spline else 0
        found = super().plain_trajectory(start, params, steps, dt, every)
        return replace(found, fallbacks=spline.outside - before if spline else 0)


def compile_head(
    head: Head, tolerance: float | None = 1e-4, reach: float = REACH, backend: Backend | None = None
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

    Example:
        >>> from dynamics import HEADS, build
        >>> head = build(HEADS["factored-radial"], bodies=3, dt=0.002)
        >>> fast = compile_head(head, tolerance=1e-2, backend="torch")
        >>> q, law = torch.randn(8, 3, 2), Parameters(torch.ones(8), torch.ones(8, 3))
        >>> torch.allclose(fast.potential.force(q, law), head.potential.force(q, law), rtol=0.05)
        True
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
    if backend not in MOST_BODIES:
        return "is unknown; use torch, numba or triton"
    if trouble := unfused(head, backend, states):
        return trouble
    if backend == "triton" and not isinstance(head.potential, PairSpline):
        law = head.potential
        if not (isinstance(law, DisplacementPotential) and law.phi.is_two_tanh_layers):
            return "evaluates splines, and of networks two tanh layers alone; give a tolerance"
        if states.dtype != torch.float32:
            return f"evaluates networks in float32, these states are in {states.dtype}"
        width, bodies = law.phi.split()[1].in_features, states.shape[-2]
        if width > WIDEST[bodies > FEW_BODIES]:
            return f"has no room for a network of {width} units and {bodies} bodies"
    wanted = "cpu" if backend == "numba" else "cuda"
    if states.device.type != wanted and not (backend == "triton" and interpreted()):
        return f"needs states on {wanted}, these are on {states.device.type}"
    if not (has_triton() if backend == "triton" else has_numba()):
        return f"is not installed; install {backend}"
    return None


def unfused(head: Hamiltonian, backend: str, states: Tensor) -> str | None:
    """Why the loops of a backend cannot roll a model or its spline, on whatever machine."""
    if not isinstance(head.kinetic, FixedKinetic) or len(head.ports):
        return "rolls |p|^2 / 2m and a pair law, with no ports and no learned kinetic energy"
    if not isinstance(head.potential, (PairSpline, *_COMPILED)):
        return "rolls one learned pair law, displacement or radial"
    if head.integrator.name not in PARTS:
        return f"has no {head.integrator.name}; it has {', '.join(PARTS)}"
    bodies, space = states.shape[-2:]
    if space != 2:
        return f"rolls bodies in a plane, these are in {space} dimensions"
    most = MOST_BODIES[backend]
    return f"holds at most {most} bodies, got {bodies}" if bodies > most else None


def fastest(device: torch.device) -> Backend:
    """The backend whose loops run where states lie."""
    return "triton" if device.type == "cuda" else "numba"


def interpreted() -> bool:
    """Whether Triton kernels run in its interpreter, on the CPU, which tests use."""
    return os.environ.get("TRITON_INTERPRET") == "1"
