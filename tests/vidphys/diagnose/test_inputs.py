"""What a user gives to `vidphys diagnose`: tables of many kinds, wrong ones, real recordings."""

import json
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics import from_config, terms
from tests.shared import small_clips
from vidphys.cli import main
from vidphys.data.formats.columns import detect_columns
from vidphys.data.rendered import write_video
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.tables import read_tracks, write_tracks
from vidphys.diagnose.weak.energy_balance import (
    corrected_rate,
    envelope_rate,
    plain_rate,
    sliding_rates,
)
from vidphys.diagnose.weak.spectrum import modes_of_data
from vidphys.errors import InputError
from vidphys.experiments.confusion.rates import potential
from vidphys.experiments.confusion.scenes import (
    KINDS,
    Kind,
    Setting,
    attracted,
    drag,
    record,
    total,
)

REAL = os.environ.get("VIDPHYS_REAL")
real = pytest.mark.skipif(REAL is None, reason="set VIDPHYS_REAL to the folder of recordings")
STEP, RATE = 0.08, 1.5


def write_csv(path, columns):
    rows = [",".join(columns)]
    rows += [",".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(rows) + "\n")


def wide(motion):
    columns = {"t": motion.times[0]}
    for body in range(motion.bodies):
        for axis, name in enumerate("xy"):
            columns[f"{name}{body + 1}"] = motion.positions[0, :, body, axis]
    return columns


# columns


@given(
    st.permutations(["t", "x1", "y1", "x2", "y2", "vx1", "note"]),
    st.sampled_from([str.lower, str.upper, str.title]),
)
def test_columns_are_found_in_any_order_and_case(names, case):
    found = detect_columns([case(name) for name in names])
    assert found.time == case("t") and not found.angles and not found.pixels
    expected = ((case("x1"), case("y1")), (case("x2"), case("y2")))
    assert found.coordinates == expected


@given(st.integers(1, 12), st.booleans())
def test_bodies_are_counted_by_their_numbers(bodies, space_is_two):
    axes = "xy" if space_is_two else "x"
    names = [f"{axis}_{n}" for n in range(1, bodies + 1) for axis in axes]
    assert len(detect_columns(["time", *names]).coordinates) == bodies


def test_angles_pixels_and_given_names_are_told():
    assert detect_columns(["t", "theta1", "theta2"]).angles
    assert detect_columns(["t", "u1", "v1"]).pixels
    found = detect_columns(["T_s", "left"], {"time": "T_s", "x": "left"})
    assert (found.time, found.coordinates) == ("T_s", (("left",),))
    found = detect_columns(["t", "x1", "y1", "x2", "y2"], {"x": "x2", "y": "y2"})
    assert (found.time, found.coordinates) == ("t", (("x2", "y2"),))


@pytest.mark.parametrize(
    "names, bodies, rates",
    [
        ("t ax ay bx by", "ax/ay bx/by", ""),  # points, as geometry programs call them
        ("t Ax Ay Bx By Cx Cy", "Ax/Ay Bx/By Cx/Cy", ""),
        ("t alpha_x alpha_y beta_x beta_y", "alpha_x/alpha_y beta_x/beta_y", ""),
        ("t p1x p1y p2x p2y", "p1x/p1y p2x/p2y", ""),
        ("t px py vx vy", "px/py", "vx vy"),  # places, as robots call them
        ("t a_px a_py b_px b_py", "a_px/a_py b_px/b_py", ""),
        ("t qx qy px py", "qx/qy", "px py"),
        ("t x y px py", "x/y", "px py"),
        ("t x y ax ay", "x/y", "ax ay"),
        ("n cx0 cy0 cx1 cy1", "cx0/cy0 cx1/cy1", ""),
    ],
)
def test_letters_that_may_be_rates_are_bodies_where_nothing_else_is_one(names, bodies, rates):
    found = detect_columns(names.split())
    assert " ".join("/".join(body) for body in found.coordinates) == bodies
    assert " ".join(found.rates) == rates


@pytest.mark.parametrize(
    "names", ["t ax ay az", "t gx gy gz ax ay az", "t,ax (m/s^2),ay (m/s^2),bx (µT),by (µT)"]
)
def test_sensors_of_a_phone_are_no_places(names):
    with pytest.raises(InputError, match="which no accelerometer or gyroscope measures"):
        detect_columns(names.split("," if "," in names else " "))


@pytest.mark.parametrize(
    "names, given_names, said",
    [
        (["t", "a", "b"], {}, "no coordinates among the columns t, a, b"),
        (["t", "x1", "y1", "x2"], {}, "body 2: columns x2, but no y"),
        (["t", "x"], {"time": "when"}, "time=when: no such column"),
    ],
)
def test_columns_that_cannot_be_told_are_said(names, given_names, said):
    with pytest.raises(InputError, match=said):
        detect_columns(names, given_names)


# tables


def test_every_kind_of_table_gives_the_same_motion(tmp_path):
    motion = record(KINDS["trap"], Setting(0.001, STEP, 2, 0), 1, 20)
    columns = wide(motion)
    write_csv(tmp_path / "wide.csv", columns)
    pq.write_table(pa.table(columns), tmp_path / "wide.parquet")
    frames, bodies = np.divmod(np.arange(40), 2)
    long = {
        "time": motion.times[0][frames],
        "id": bodies.astype(float),
        "x": motion.positions[0, frames, bodies, 0],
        "y": motion.positions[0, frames, bodies, 1],
    }
    write_csv(tmp_path / "long.csv", long)
    np.savez(tmp_path / "arrays.npz", positions=motion.positions, dt=STEP)
    text = "\n".join(
        " ".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True)
    )
    (tmp_path / "text.txt").write_text("% " + " ".join(columns) + "\n" + text)
    for name in ("wide.csv", "wide.parquet", "long.csv", "arrays.npz", "text.txt"):
        found = read_tracks(tmp_path / name).motion
        np.testing.assert_allclose(found.positions, motion.positions, atol=1e-7, err_msg=name)
        assert found.interval == pytest.approx(STEP)


def test_a_body_that_is_missing_from_a_frame_is_a_gap(tmp_path):
    t = np.repeat(np.arange(10) * STEP, 2)
    columns = {"t": t, "body": np.tile([1.0, 2.0], 10), "x": np.arange(20.0), "y": np.zeros(20)}
    write_csv(tmp_path / "t.csv", {k: np.delete(v, 7) for k, v in columns.items()})
    seen = read_tracks(tmp_path / "t.csv").motion.seen
    assert not seen[0, 3, 1] and seen.sum() == 19


@pytest.mark.parametrize(
    "text, said",
    [
        ("a,b\n1,2\n", "no coordinates"),
        ("x,y\n" + "1,2\n" * 20, "--interval"),
        ("t,x\n" + "\n".join(f"{i * 0.1},{i}" for i in range(4)), "longer recording"),
        ("t,x\n" + "\n".join(f"{i * 0.1},word" for i in range(20)), "not numbers"),
        ("t,x\n" + "0.0,1\n" * 20, "times must increase"),
    ],
)
def test_tables_that_hold_no_tracks_end_in_one_line(tmp_path, capsys, text, said):
    path = tmp_path / "t.csv"
    path.write_text(text)
    assert main(["diagnose", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("error: ") and said in error and "\n" not in error
    assert not (tmp_path / "out" / "run.json").exists()


# the command


def test_a_table_is_diagnosed_and_everything_is_written(tmp_path, capsys):
    motion = record(KINDS["trap-drag"], Setting(0.003, 0.05, 1, 0), 1, 160)
    write_csv(tmp_path / "t.csv", wide(motion))
    out = tmp_path / "out"
    assert main(["diagnose", str(tmp_path / "t.csv"), "--out", str(out), "--quiet"]) == 0
    data = json.loads((out / "diagnosis.json").read_text())
    assert data["terms"] == ["linear", "trap"] and data["explained"]
    errors = data["forecast_error"]
    assert errors["model"] < min(v for k, v in errors.items() if k != "model")
    assert (out / "recordings" / "diagnosis.rrd").exists()
    assert (out / "figures" / "diagnosis.svg").exists()
    held = json.loads((out / "specification.json").read_text())
    term = from_config(held["terms"])
    assert [(x.law, x.strength) for x in term.ports] == [("linear", "positive")]
    trap = next(x for x in term.parts() if isinstance(x, terms.Trap))
    assert trap.stiffness == pytest.approx(1.5, rel=0.02)
    assert "as a spring does" in capsys.readouterr().out
    assert main(["diagnose", str(tmp_path / "t.csv"), "--out", str(out), "--hold-out", "0.2"]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_inputs_that_are_not_there_or_not_known(tmp_path, capsys):
    for name in ("a.doc", "a.txt"):
        (tmp_path / name).write_text("x")
    for arguments, said in (
        (["nowhere.csv"], "no such file"),
        ([str(tmp_path / "a.doc")], "neither a table nor a clip"),
        ([str(tmp_path / "a.txt")], "is called .txt, but no table and no clip is in it"),
        (["nowhere.csv", "--hold-out", "1.5"], "--hold-out 1.5"),
        (["nowhere.csv", "--columns", "x"], "write ROLE=NAME"),
        (["nowhere.csv", "--bodies", "2"], "--bodies: would have no effect: nowhere.csv is not"),
        (["nowhere.mp4", "--angles"], "--angles: would have no effect: nowhere.mp4 is a clip"),
        (["nowhere.mp4", "--binder", "motoin"], "did you mean 'motion'"),
        (["nowhere.mp4", "--shadow", "1.5"], "--shadow 1.5: must be above 0 and at most 1"),
        (["nowhere.mp4", "--bodies", "0"], "--bodies 0: follow at least 1"),
    ):
        assert main(["diagnose", *arguments, "--out", str(tmp_path / "out")]) == 2
        assert said in capsys.readouterr().err


def test_a_grey_clip_is_followed_unless_told_that_brightness_is_a_shadow(tmp_path, capsys):
    clip, out = tmp_path / "grey.avi", tmp_path / "out"
    places = small_clips.swing(60, 0.0)
    grey = small_clips.pictures(places).mean(-1, keepdims=True).repeat(3, -1).astype(np.uint8)
    write_video(clip, grey, small_clips.RATE)
    assert main(["diagnose", str(clip), "--shadow", "0.6", "--out", str(out)]) == 2
    assert "shadow 1" in capsys.readouterr().err
    assert not out.exists()
    assert main(["diagnose", str(clip), "--out", str(out)]) == 0
    followed = read_tracks(out / "tracks.csv").motion.positions[0]
    half = (small_clips.SIDE - 1) / 2
    seen = followed * [1, -1] * small_clips.SIDE / 2 + half
    assert np.abs(seen - places).max() < 0.7


# the energy balance (X1-X5)


def clips(law, sigma, step=STEP):
    return record(Kind("balance", law, None), Setting(sigma, step, 3, 0), 32, 24)


def test_the_energy_balance_is_exact_without_noise_and_its_reverse_the_negative():
    damped = clips(total(attracted, drag(RATE, 1)), 0.0, 0.02)
    assert plain_rate(damped, potential).value == pytest.approx(RATE, rel=2e-3)
    forward, backward = (corrected_rate(m, potential) for m in (damped, damped.reversed()))
    assert forward.value == pytest.approx(RATE, rel=3e-3)
    assert backward.value == pytest.approx(-forward.value, rel=1e-9)
    assert forward.carried == forward.value and backward.carried == 0.0


def test_noise_attenuates_the_plain_balance_and_not_the_corrected_one():
    damped = clips(total(attracted, drag(RATE, 1)), 0.02, 0.04)
    assert plain_rate(damped, potential).value < 0.8 * RATE
    corrected = corrected_rate(damped, potential)
    assert corrected.value == pytest.approx(RATE, rel=0.1)
    assert corrected.low < RATE < corrected.high


def test_without_friction_the_balance_is_zero_where_the_envelope_alone_is_wrong():
    still = clips(attracted, 0.005, 0.02)
    assert abs(corrected_rate(still, potential).value) < 0.05
    assert envelope_rate(still) < -0.1  # infall looks like friction that adds energy


def test_a_sliding_balance_sees_when_the_medium_changes():
    damped = total(attracted, drag(RATE, 1))

    def law(q, v, t):
        return damped(q, v, t) if t >= 12 * STEP - 1e-9 else attracted(q, v, t)

    times, rates = sliding_rates(clips(law, 0.005), potential, sigma=0.005)
    before, after = rates[times < 9 * STEP], rates[times > 15 * STEP]
    assert abs(np.median(before)) < 0.1 and np.median(after) == pytest.approx(RATE, rel=0.1)


# spectra


def test_two_damped_oscillations_are_read_from_the_spectrum():
    t = np.arange(600) * 0.05
    q = 2 * np.exp(-0.02 * t) * np.cos(2.0 * t) + np.exp(-0.05 * t) * np.sin(7.0 * t)
    q += 0.01 * np.random.default_rng(0).standard_normal(len(t))
    slow, fast = modes_of_data(t, q[:, None, None], 2)
    assert (slow.frequency, fast.frequency) == pytest.approx((2.0, 7.0), rel=2e-3)
    assert (slow.decay, fast.decay) == pytest.approx((0.02, 0.05), rel=0.05)


# real recordings


def told_of(path, out):
    """What the verb says of a recording, with no option; it foretells better than any guess."""
    assert main(["diagnose", str(path), "--out", str(out), "--quiet"]) == 0
    data = json.loads((out / "diagnosis.json").read_text())
    errors = data["forecast_error"]
    share = errors["model"] / min(v for k, v in errors.items() if k != "model")
    return data, data["mechanism"][0]["quantities"], share


@real
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "name, on, terms_of_it", [("one_mass", "plane", "trap"), ("pendulum", "angle", "pendulum")]
)
def test_real_recordings_are_modelled_and_foretold(tmp_path, name, on, terms_of_it):
    path = Path(REAL or "") / f"{name}_mocap.txt"
    data, numbers, share = told_of(path, tmp_path / "out")
    assert data["explained"] and {"linear", terms_of_it} <= set(data["terms"]) and share < 0.1
    assert data["mechanism"][0]["moves on"] == on
    motion = read_tracks(path).motion
    (mode,) = modes_of_data(motion.times[0], motion.positions[0], 1)
    # a wide swing lasts longer than a small one; this one dies away from its first width
    wide = float(np.sqrt(2) * motion.positions.std()) if name == "pendulum" else 0.0
    period = numbers["period"]["value"] * (1 + wide**2 / 16 + 11 * wide**4 / 3072)
    assert period == pytest.approx(2 * np.pi / mode.frequency, rel=3e-3)
    if name == "one_mass":
        assert numbers["linear friction"]["value"] == pytest.approx(2 * mode.decay, rel=0.03)


@real
@pytest.mark.timeout(600)
def test_a_real_weight_is_let_go_and_strikes_a_wall(tmp_path):
    path = Path(REAL or "") / "pendulum_string.mp4"
    data, numbers, share = told_of(path, tmp_path / "out")
    # by eye the hand, which the picture's edge cuts, opens in frames 8 to 10
    assert 7 <= data["shown"]["first"] <= 11
    assert {"pendulum", "wall"} < set(data["terms"]) and {"linear", "square"} & set(data["terms"])
    assert data["status"] != "not explained" and share < 0.5
    assert 0 < numbers["restitution"]["value"] < 1


@real
@pytest.mark.timeout(600)
@pytest.mark.parametrize("clip, axis", [("ball_toss.mp4", 2), ("puck_constant_force.avi", 1)])
def test_what_a_hand_sets_going_is_followed_and_not_the_hand(tmp_path, clip, axis):
    data, _, share = told_of(Path(REAL or "") / clip, tmp_path / "out")
    assert data["terms"] == ["uniform"] and data["status"] != "not explained" and share < 1
    found = json.loads((tmp_path / "out" / "specification.json").read_text())
    pull = {k: found["numbers"][f"force {k}"]["value"] for k in (1, 2)}
    assert abs(pull[axis]) > 10 * abs(pull[3 - axis])  # the hand does not move along one axis


def test_a_motion_needs_frames_and_increasing_times():
    with pytest.raises(ValueError, match="8 frames or more"):
        motion_of(np.zeros((1, 5, 1, 2)), STEP)


def test_written_tracks_are_read_as_they_were(tmp_path):
    q = np.random.default_rng(0).normal(size=(1, 9, 2, 2))
    q[0, 3, 1] = np.nan
    write_tracks(tmp_path / "tracks.csv", motion_of(q, 0.04))
    read = read_tracks(tmp_path / "tracks.csv").motion
    np.testing.assert_array_equal(read.positions, q)
    np.testing.assert_allclose(read.times[0], 0.04 * np.arange(9), rtol=1e-12)
