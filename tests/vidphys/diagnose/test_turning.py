"""Coordinates whose unit is not told: angles by how they move, and nothing else."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vidphys.cli import main
from vidphys.diagnose.mechanisms.turning import turned, turns_in
from vidphys.diagnose.recordings.motion import Motion, motion_of

TIMES = np.arange(240) / 30
RATE = 4.0  # 1/s, of small swings


def moving(force: Callable[[float], float], wide: float, noise: float = 0.004) -> Motion:
    """A coordinate that is let go at ``wide``, slightly rubbed."""
    found = solve_ivp(
        lambda _, y: (y[1], force(y[0]) - 0.05 * y[1]), (0, 9), (wide, 0), t_eval=TIMES, rtol=1e-9
    )
    places = found.y[0] + noise * wide * np.random.default_rng(0).standard_normal(len(TIMES))
    return motion_of(places[None, :, None, None], 1 / 30)


def swing(wide: float = 1.2) -> Motion:
    return moving(lambda x: -(RATE**2) * np.sin(x), wide)


@pytest.mark.parametrize(("unit", "per"), [("radians", 1.0), ("degrees", 180 / np.pi)])
def test_a_wide_swing_tells_its_unit(unit: str, per: float):
    shown = motion_of(per * swing().positions, 1 / 30)
    assert turns_in(shown) == unit
    assert np.allclose(turned(shown, unit).positions, swing().positions)


@pytest.mark.parametrize(
    ("force", "wide"),
    [
        (lambda x: -(RATE**2) * x, 0.3),  # a pendulum would swing nearly so
        (lambda x: -(RATE**2) * x, 0.9),
        (lambda x: -(RATE**2) * x, 40.0),
        (lambda x: -10 * np.sign(x) * abs(x) ** 0.5, 0.6),
        (lambda x: -10 * x * abs(x), 1.5),
        (lambda x: -(RATE**2) * np.sin(x), 0.2),  # too small a swing to tell
    ],
)
def test_a_place_is_no_angle(force: Callable[[float], float], wide: float):
    assert turns_in(moving(force, wide)) == ""


def test_a_table_without_names_is_read_as_it_moves(tmp_path: Path, capsys):
    table = tmp_path / "t.txt"
    np.savetxt(table, np.column_stack([TIMES, 180 / np.pi * swing().positions[0, :, 0, 0]]))
    assert main(["diagnose", str(table), "--out", str(tmp_path / "run"), "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "angle in degrees, and is taken for one" in said
    assert "as a pendulum" in said
