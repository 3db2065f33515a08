"""Shapes are checked as a test runs: in its first calls, and in those of the next test again."""

import jaxtyping
import pytest
import torch

from dynamics.state import kinetic_energy
from tests.shared import checked

MASSES = torch.ones(3)


@pytest.mark.parametrize("turn", [0, 1])
def test_a_wrong_shape_is_refused_until_a_test_has_had_its_share(turn):
    momenta = torch.zeros(3, 2)
    with pytest.raises(jaxtyping.TypeCheckError):
        kinetic_energy(momenta.long(), MASSES)
    for _ in range(checked.MOST):
        kinetic_energy(momenta, MASSES)
    assert jaxtyping.config.jaxtyping_disable
    kinetic_energy(momenta.long(), MASSES)
