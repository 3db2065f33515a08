"""A table with a column that is known to drive its body, such as a motor's torque."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vidphys.cli import main
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.mechanism import find_mechanism
from vidphys.diagnose.mechanisms.quantities import quantities
from vidphys.diagnose.recordings.inputs import Signal
from vidphys.diagnose.recordings.tables import read_tracks

REAL = os.environ.get("VIDPHYS_REAL")
STEP, SWING, RATE, GAIN = 0.02, 20.0, 0.3, 6.0
TIMES = np.arange(300) * STEP
TORQUE = 1.5 * np.sin(2.2 * TIMES) * np.cos(0.7 * TIMES**1.3)


def angles(times=TIMES):
    """Of a pendulum that a motor pushes, by another's integrator."""

    def slope(t, y):
        return [y[1], -SWING * np.sin(y[0]) - RATE * y[1] + GAIN * np.interp(t, TIMES, TORQUE)]

    found = solve_ivp(slope, (0, 6), [0.2, 0.0], t_eval=times, rtol=1e-9, atol=1e-10, max_step=STEP)
    return found.y[0]


def write(path, name="torque"):
    noise = 2e-3 * np.random.default_rng(0).standard_normal(len(TIMES))
    rows = np.column_stack([TIMES, angles() + noise, TORQUE])
    np.savetxt(path, rows, delimiter=",", header=f"t,theta,{name}", comments="")


def test_the_compiled_steps_take_a_push_in_the_middle_of_theirs():
    law = Law(1, "pendulum", "linear", inputs=1)
    signal = Signal(("torque",), TIMES, TORQUE[:, None])
    start = np.array([[0.2], [0.0]])
    out = law.roll(np.array([SWING, RATE, GAIN]), start, TIMES, signal)
    np.testing.assert_allclose(out[:, 0, 0], angles(), atol=2e-4)
    half = law.roll(np.array([SWING, RATE, GAIN]), out[150], TIMES[:100], signal.since(TIMES[150]))
    np.testing.assert_allclose(half[:, 0, 0], out[150:250, 0, 0], atol=1e-4)


@pytest.mark.parametrize("name, given", [("torque", {}), ("strange", {"input": "strange"})])
def test_a_known_torque_is_told_from_what_the_pendulum_does_itself(tmp_path, name, given):
    write(tmp_path / "t.csv", name)
    loaded = read_tracks(tmp_path / "t.csv", given)
    assert "known inputs: " + name in loaded.notes[0]
    (group,) = find_mechanism(loaded.motion, loaded.angles).groups
    assert group.fit.kinds == {"pendulum", "linear", "input"}
    found = {x.name: x for x in quantities(group.fit)}
    for told, true in (("rate", SWING**0.5), (f"acceleration by one {name}", GAIN)):
        assert found[told].value == pytest.approx(true, rel=0.01)
        assert abs(found[told].value - true) < 4 * found[told].error


def test_without_its_column_the_same_motion_is_not_explained_and_with_it_all_is_said(tmp_path):
    write(tmp_path / "t.csv")
    out = tmp_path / "out"
    assert main(["diagnose", str(tmp_path / "t.csv"), "--out", str(out), "--quiet"]) == 0
    data = json.loads((out / "diagnosis.json").read_text())
    assert data["status"] == "explained" and "input" in data["terms"]
    assert data["forecast_error"]["model"] < 0.01
    held = json.loads((out / "specification.json").read_text())
    assert held["inputs"] == ["torque"]
    assert held["numbers"]["gain 1"]["value"] == pytest.approx(GAIN, rel=0.01)


@pytest.mark.skipif(REAL is None, reason="set VIDPHYS_REAL to the folder of recordings")
@pytest.mark.timeout(600)
def test_a_real_motor_s_torque_is_taken_for_what_pushes_the_pendulum():
    loaded = read_tracks(Path(REAL or "") / "pendulum_torque.csv")
    (group,) = find_mechanism(loaded.motion, loaded.angles).groups
    assert {"pendulum", "input"} <= group.fit.kinds
    found = {x.name: x for x in quantities(group.fit)}
    assert found["rate"].value == pytest.approx(4.5, rel=0.1)  # half a metre
    assert found["acceleration by one torque"].value > 0
