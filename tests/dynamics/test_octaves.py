"""Polynomials by octaves: compiled against plain numpy, with permutations and without."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from dynamics.compiled import compile_head
from dynamics.compiled.spline import OCTAVE_DEGREE, OCTAVES, RadialSpline
from tests.dynamics.test_compiled import DT, episodes, model, spread

needs_numba = pytest.mark.skipif(
    importlib.util.find_spec("numba") is None, reason="numba is not installed"
)


def differences() -> dict[str, float]:
    """Largest difference of compiled polynomials from the plain ones, in roundings."""
    from numba import njit

    from dynamics.compiled import octaves

    coarse, fine = octaves.coarse_polynomials, octaves.fine_polynomials

    @njit
    def compiled(fineness, table, rows):
        if fineness == 0:
            coarse(fineness, table, rows, 0, 1)
        fine(fineness, table, rows, 0, 2)

    rng, found = np.random.default_rng(0), {}
    for real in (np.float32, np.float64):
        for fineness in (0, 2):
            table = rng.normal(size=(OCTAVE_DEGREE + 1) * (OCTAVES << fineness)).astype(real)
            rows = np.empty((3, octaves.TILE), real)
            rows[:] = np.exp(rng.uniform(-5, 13, octaves.TILE))
            plain = rows.copy()
            octaves._plainly(fineness, table, plain, 0, 1)
            compiled(fineness, table, rows)
            for row in (1, 2)[fineness > 0 :]:
                wrong = np.abs(rows[row] - plain[1]).max() / np.finfo(real).eps
                found[f"{real.__name__}, fineness {fineness}, row {row}"] = float(wrong)
    return found


@needs_numba
def test_compiled_polynomials_are_the_plain_ones():
    assert max(differences().values()) < 20


@needs_numba
def test_processors_without_permutations_load():
    code = "from tests.dynamics.test_octaves import differences as d; assert max(d().values()) < 20"
    plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    where = {**os.environ, **plain, "PYTHONPATH": str(Path(__file__).parents[2])}
    subprocess.run([sys.executable, "-c", code], check=True, env=where)


def sharp(dtype: torch.dtype):
    """A law with features that are far narrower than an octave."""
    head = model("radial")
    with torch.no_grad():
        head.potential.phi.layers[0].weight *= 12
        head.potential.phi.layers[0].bias *= 12
    return head.to(dtype)


@pytest.mark.slow
@needs_numba
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_sharp_law_has_more_pieces_and_meets_its_tolerance(dtype):
    head = sharp(dtype)
    fused, twin = (compile_head(head, 1e-4, backend=b) for b in ("numba", "torch"))
    assert fused.potential.resolution > 0 and fused.report.error <= 1e-4
    start, params = episodes(66, dtype=dtype)
    found, expected = (x.trajectory(start, params, 20, DT).states.p for x in (fused, twin))
    size = 200 * torch.finfo(dtype).eps  # of forces that change within a hundredth of a unit
    torch.testing.assert_close(found, expected, rtol=size, atol=size)


def test_a_finer_spline_has_the_same_energy():
    network = model("radial").potential
    apart = spread(200)
    coarse, fine = (RadialSpline(network, fineness, 100.0) for fineness in (0, 3))
    exact = network.pair_energy(apart).detach()
    for spline, bound in ((coarse, 1e-6), (fine, 1e-13)):
        assert float((spline.pair_energy(apart) - exact).abs().max()) < bound


def test_a_radial_law_reaches_so_far_and_no_farther():
    with pytest.raises(ValueError, match="compiled up to 2048 world units, not 3000"):
        compile_head(model("radial"), 1e-3, reach=3000.0)
    apart = torch.tensor([[2047.0, 0.0], [2040.0, 150.0]], dtype=torch.float64)
    head = model("radial")
    far = compile_head(head, 1e-6, reach=RadialSpline.FARTHEST).potential
    torch.testing.assert_close(
        far.pair_gradient(apart), head.potential.pair_gradient(apart), rtol=1e-6, atol=0
    )
