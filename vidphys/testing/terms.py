"""Whether a part of a model keeps its contract: a potential, a kinetic energy or a port."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from dynamics import Parameters
from dynamics.potentials import PairPotential
from dynamics.terms import (
    Hamiltonian,
    HeadTerm,
    KineticTerm,
    NoPotential,
    PortTerm,
    PotentialTerm,
    Sizes,
    Term,
)
from vidphys.testing.failed import (
    ALIKE,
    CheckFailed,
    expect,
    expect_same,
    expect_slope,
    expect_spoiled,
    slope_of,
)
from vidphys.testing.heads import DT, check_config, check_head
from vidphys.testing.states import alike, episodes, law


def check_term(
    term: Term,
    bodies: int = 3,
    space: int = 2,
    params: Parameters | None = None,
    reciprocal: bool | None = None,
    impulsive: bool = False,
) -> None:
    """Check a term by itself, and a model that is made with it by :func:`check_head`.

    A potential's force is minus the gradient of its energy, a kinetic energy's velocity is its
    gradient, and a port does nothing in no time; the term survives its configuration.

    Args:
        term: a potential, a kinetic energy, a port, or a whole model.
        bodies, space: see :func:`check_head`.
        params: see there.
        reciprocal: whether the forces of a potential add up to none and equal bodies may change
            places; those of a ``PairPotential`` must, where not given.
        impulsive: whether a port acts at once, however short the step is.

    Raises:
        CheckFailed: what was expected, and what came.
    """
    if isinstance(term, HeadTerm):
        check_head(term, bodies, space, params)
        return
    check_config(term)
    given = law(bodies) if params is None else params
    sizes = Sizes(bodies, space, given.flat.shape[-1], DT)
    made, start = _built(term, sizes), episodes(bodies, space)
    if isinstance(term, PotentialTerm):
        fair = isinstance(made, PairPotential) if reciprocal is None else reciprocal
        _check_potential(made, start.q, given, fair)
        model = Hamiltonian(potentials=(term,))
        check_head(model, bodies, space, given, exchangeable=fair)
    elif isinstance(term, KineticTerm):
        _check_derivative(made, made.velocity, 1, start.p, given, "velocity")
        check_head(Hamiltonian(kinetic=term), bodies, space, given)
    elif isinstance(term, PortTerm):
        still = made.kick(start, given, 0.0)
        what = f"{type(made).__name__}.kick in no time"
        if not impulsive:
            expect_same(still, start.p, what, "momenta as they were")
        model = Hamiltonian(potentials=(NoPotential(),), ports=(term,))
        check_head(model, bodies, space, given, impulsive=impulsive)
    else:
        kinds = "a potential, a kinetic energy, a port or a head"
        raise CheckFailed(f"a term: expected {kinds}, got {type(term).__name__}")


def _built(term: Any, sizes: Sizes) -> Any:
    torch.manual_seed(0)
    return term.build(sizes).double().eval()


def _check_potential(made: Any, q: Tensor, params: Parameters, reciprocal: bool) -> None:
    name = type(made).__name__
    _check_derivative(made, made.force, -1, q, params, "force")
    spoiled = q.clone()
    spoiled[0, 0, 0] = math.nan
    if not torch.equal(made.force(q, params), made.force(1.1 * q, params)):
        expect_spoiled(lambda: made.force(spoiled, params)[0], f"{name}.force at a NaN")
    if not reciprocal:
        return
    force = made.force(q, params).detach()
    size = force.abs().sum(-2).clamp_min(1e-300)
    left = float((force.sum(-2) / size).abs().max())
    expect(left < ALIKE, f"{name}.force", "forces that add up to none", f"{left:.2g} of them")
    turn = list(range(1, q.shape[-2])) + [0]
    energies = made.energy(q[:, turn], alike(params)), made.energy(q, alike(params))
    expect_same(*energies, f"{name}.energy", "equal bodies to change places")


def _check_derivative(
    made: Any, slope: Any, sign: int, x: Tensor, params: Parameters, word: str
) -> None:
    """The force or the velocity that is written out, against the energy's gradient."""
    name, shape = type(made).__name__, tuple(params.coupling.shape)
    energy = made.energy(x, params)
    expect(tuple(energy.shape) == shape, f"{name}.energy", f"shape {shape}", tuple(energy.shape))
    found = slope(x, params)
    expect(found.shape == x.shape, f"{name}.{word}", f"shape {tuple(x.shape)}", tuple(found.shape))
    gradient = slope_of(lambda y: made.energy(y, params), x)
    if bool(gradient.any()):
        expect_slope(lambda y: made.energy(y, params), x, f"{name}.energy")
    words = "minus the gradient of its energy" if sign < 0 else "the gradient of its energy"
    if getattr(made, "conservative", True):
        expect_same(sign * gradient, found.detach(), f"{name}.{word}", words)
    for index in range(len(x)):
        alone = slope(x[index], params[index]).detach()
        what = f"{name}.{word}"
        expect_same(found[index].detach(), alone, what, "an episode alone as in company")
