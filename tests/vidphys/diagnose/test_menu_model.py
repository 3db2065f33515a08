"""The models that terms of the menu stand for have the forces that were fitted."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from dynamics import Parameters, PhaseState, build, terms
from vidphys.diagnose.explanations.menu_model import model_of, shaped
from vidphys.diagnose.inference.menu import PAIR, Field, pair_term, pair_terms

RNG = np.random.default_rng(3)
PLACES = RNG.uniform(-1, 1, (5, 1, 3, 2))  # (w, m, n, d)
MASS = RNG.uniform(0.5, 2.0, (5, 3))
FIELD = Field(PLACES, PLACES, np.zeros((5, 1)), MASS, np.full(5, -1.3))
LAW = Parameters(torch.full((5,), -1.3, dtype=torch.float64), torch.tensor(MASS))


@pytest.mark.parametrize("source", ["mass", "alike"])
def test_every_pair_force_of_the_menu_has_its_model(source):
    state = PhaseState(torch.tensor(PLACES[:, 0]), torch.zeros(5, 3, 2).double())
    kinds = set()
    for term in pair_terms(FIELD.distance, source):
        strengths = RNG.uniform(0.5, 1.5, len(term.coefficients))
        found = (term.columns(FIELD) @ strengths)[:, 0]
        model = terms.Hamiltonian(potentials=tuple(shaped(term, strengths)))
        fixed = model.throughout(learned=False)
        force = build(fixed, 3, 0.01).force(state, LAW).numpy()
        np.testing.assert_allclose(force / MASS[..., None], found, rtol=1e-9, atol=1e-12)
        kinds.add(term.shape)
    assert len(kinds) == 11


@pytest.mark.parametrize(
    "shape, explained, model",
    [
        ("spring", True, terms.Shaped("mass", shape="spring", strength=0.7)),
        ("spring", False, terms.Radial()),
        ("contact", True, terms.Shaped("mass", shape="contact", strength=0.7, length=0.3)),
        ("contact", False, terms.Knots(reach=0.3)),
    ],
)
def test_a_force_that_leaves_more_than_noise_is_learned_anew(shape, explained, model):
    pair = pair_term(shape, 0.3 if shape == "contact" else None, "mass")
    structure = SimpleNamespace(
        term=lambda family: pair if family == PAIR else None, of=lambda _: np.array([0.7])
    )
    found = SimpleNamespace(
        structure=structure, kinds={pair.kind}, leftover=SimpleNamespace(explained=explained)
    )
    assert model_of(found).potentials == (model,)
