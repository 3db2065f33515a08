"""Which form of a trained model is rolled: itself, or a spline where it is near enough and pays.

The choice is made by sizes and by the measured error of the force, never by a clock: the same
question is rolled by the same form on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass

from dynamics.compiled.head import compile_head, fastest, unfused
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head
from dynamics.state import Parameters, PhaseState
from dynamics.substeps import watched

TOLERANCE = 1e-4  # of the pair force, relative to the float64 network's: see ``compile_head``
PAYS = 130_000  # steps of single episodes that save what a spline of a network of width 64 takes
FEW = 64  # episodes; each step of fewer takes a network about as long


@dataclass(frozen=True)
class Form:
    """What is to be rolled in place of a trained model.

    Args:
        head: its spline's, a :class:`dynamics.compiled.CompiledHead`, or the model as it is.
        why: it is rolled as it is, in words; empty where there is a spline.
    """

    head: Head
    why: str = ""


def form_of(
    head: Head,
    start: PhaseState,
    params: Parameters,
    steps: int | None,
    dt: float,
    substeps: bool = True,
) -> Form:
    """The form in which a model is to be rolled where no gradient is asked.

    Args:
        head: any. What a spline is made of is copied: the model itself is not changed.
        start: ``(..., n, d)``, in the precision of the model and where it is.
        params: of its episodes.
        steps: that are to be rolled; ``None`` for a model that is rolled again and again.
        dt: seconds of each.
        substeps: see :func:`dynamics.rollout`; steps that are taken apart have no fused loops.

    Example:
        >>> import torch
        >>> from dynamics import HEADS, build
        >>> head = build(HEADS["factored-radial"], bodies=3, dt=0.002)
        >>> start = PhaseState(torch.randn(8, 3, 2), torch.zeros(8, 3, 2))
        >>> law = Parameters(torch.ones(8), torch.ones(8, 3))
        >>> form_of(head, start, law, steps=10_000, dt=0.002).head.report.error < TOLERANCE
        True
        >>> form_of(head, start, law, steps=100, dt=0.002).why
        '100 steps of 8 episodes are too few for a spline to pay'
    """
    episodes, backend = start.q.shape[:-2].numel(), fastest(start.q.device)
    if steps is not None and steps * max(episodes, FEW) < PAYS:
        return Form(head, f"{steps} steps of {episodes} episodes are too few for a spline to pay")
    if isinstance(head, Hamiltonian) and (trouble := unfused(head, backend, start.q)):
        return Form(head, f"{backend} {trouble}")
    if substeps and watched(head, start, params, dt):
        return Form(head, "steps that close encounters may need in pieces are taken one by one")
    try:
        return Form(compile_head(head, TOLERANCE))
    except ValueError as error:
        return Form(head, str(error).removeprefix("compile_head: "))
