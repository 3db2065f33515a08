"""Pair forces of known shapes: their energies, cores and units, and those that a diagnosis fits."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dynamics import Parameters, PhaseState, build, terms
from dynamics.shapes import CORE, SHAPES, ShapedPotential
from vidphys.diagnose.inference import menu

each_shape = pytest.mark.parametrize("shape", SHAPES)
LENGTH = 0.8


def pair(shape: str, r: float) -> tuple[float, float]:
    """Energy of two unit masses, and the force by which each is pulled to the other."""
    law = Parameters(torch.ones(()).double(), torch.ones(2).double())
    q = torch.tensor([[0.0, 0.0], [0.6 * r, 0.8 * r]], dtype=torch.float64)
    potential = ShapedPotential(shape, 1.7, LENGTH, learned=False)
    force = potential.force(q, law)[0]
    along = float(force @ q[1]) / r if r else float(force.norm())
    return float(potential.energy(q, law)), along


@each_shape
@given(r=st.floats(0.5 * CORE, 3.0))
def test_the_force_is_the_slope_of_the_energy_within_the_core_too(shape, r):
    apart = 1e-4 * r
    if abs(r - LENGTH) < 2 * apart or abs(r - CORE) < 2 * apart:
        return  # a kink of the force
    (far, _), (near, _), (_, force) = (pair(shape, x) for x in (r + apart, r - apart, r))
    size = max(abs(force), 1e-6)
    assert (far - near) / (2 * apart) == pytest.approx(force, abs=1e-5 * size + 1e-9)


@each_shape
@given(r=st.floats(2 * CORE, 3.0))
def test_a_diagnosis_fits_the_same_force(shape, r):
    found = 1.7 * menu.SHAPES[shape](np.array(r), LENGTH) * r
    assert pair(shape, r)[1] == pytest.approx(float(found), rel=1e-12)
    assert set(menu.SHAPES) - set(menu.BETWEEN) == set(SHAPES)  # those between are never told


@pytest.mark.parametrize("shape", [name for name in SHAPES if SHAPES[name].sharp])
def test_a_force_without_a_bound_is_bounded_by_its_core(shape):
    edge, inside = pair(shape, 1.0001 * CORE)[1], pair(shape, 0.5 * CORE)[1]
    assert inside == pytest.approx(0.5 * edge, rel=2e-3)
    assert pair(shape, 0.0)[1] == 0


@each_shape
def test_in_other_units_bodies_move_alike(shape):
    length, seconds, steps = 3.0, 0.7, 50
    places = [[0.0, 0.0], [0.7, 0.5], [-0.6, 0.8]]
    q = torch.tensor([places], dtype=torch.float64)
    start = PhaseState(q, torch.tensor([[[0.0, 0.3], [-0.2, 0.0], [0.1, -0.1]]]).double())
    law = Parameters(torch.full((1,), -0.8).double(), torch.tensor([[1.0, 2.0, 0.7]]).double())
    pull = terms.Shaped(shape=shape, strength=0.5, length=1.2, learned=False)
    term = terms.Hamiltonian(potentials=(pull,))
    path = build(term, 3, 0.01).double().trajectory(start, law, steps, 0.01).states.q
    counted = PhaseState(start.q / length, start.p * seconds / length)
    other = build(term.counted_in(length, seconds), 3, 0.01).double()
    again = other.trajectory(counted, law, steps, 0.01 / seconds).states.q
    torch.testing.assert_close(again * length, path, rtol=1e-10, atol=1e-10)
    free = start.q + 0.5 * start.p / law.mass[..., None]
    assert float((path[:, -1] - free).abs().max()) > 1e-3  # it acts


@pytest.mark.parametrize(
    "given, why",
    [
        ({"shape": "inverse-squared"}, "unknown shape 'inverse-squared'; known: inverse-square,"),
        ({"length": 0.0}, "length must be > 0, got 0.0"),
    ],
)
def test_a_shape_that_is_none_is_refused(given, why):
    with pytest.raises(ValueError, match=why):
        build(terms.Hamiltonian(potentials=(terms.Shaped(**given),)), 2, 0.01)
