"""What `render` stores beside its clips: every scene, its places, and the slopes of its states."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from pandas import read_csv
from torch import Generator

from dynamics import ExactBath, Friction, Parameters, PhaseState
from dynamics.bath import DrivenBath, FullBath
from dynamics.ports import LinearFriction
from renderers import WORLDS, Camera
from vidphys.data.clips import render_clips
from vidphys.data.rendered import RenderSettings, render_folder, truth_of
from vidphys.data.sets.folder import read_manifest
from vidphys.errors import InputError
from vidphys.runs.folder import RunFolder
from vidphys.scenes import SCENES, Scene, gravity
from vidphys.scenes.langevin import BathScene

CLIPS, SHORT, LONG = 4, 9, 400  # clips, and frames of each
WITHIN = 2e-4  # of the largest derivative: what differences and steps of the truth are off by
STEP = 0.001  # seconds, of scenes whose step is free


def filmed(scene: Scene, frames: int):
    world = WORLDS["anonymous"](Camera(scene.half_extent, 4, 4))
    return render_clips(scene, world, CLIPS, frames, 1, 0, "slopes")


def cold(sample, n: int, rng: Generator) -> tuple[PhaseState, Parameters]:
    start, params = sample(n, rng)
    return start, params.with_scalar("temperature", 0.0 * params.scalar("temperature"))


def slopes_of(values: np.ndarray, interval: float) -> np.ndarray:
    """Central differences of fourth order over time, of all rows but two at either end."""
    near, far = values[3:-1] - values[1:-3], values[4:] - values[:-4]
    return (8 * near - far) / (12 * interval)


def pairs_of(scene: Scene, frames: int) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Of each derivative that is stored, measured and stored values of all clips."""
    clips = filmed(scene, frames)
    tables = [truth_of(clips, k, scene).to_pydict() for k in range(CLIPS)]
    axes = ("x", "y") if scene.space == 2 else ("",)
    places = {"x": "x", "y": "y", "": "q"}
    for axis in axes:
        for state, slope in ((places[axis], f"v{axis}"), (f"p{axis}", f"f{axis}")):
            measured, stored = [], []
            for table in tables:
                for body in range(1, scene.bodies + 1):
                    values = np.array(table[f"{state}{body}"])
                    if scene.box is not None and state in places:
                        values = np.unwrap(values, period=scene.box)
                    measured.append(slopes_of(values, clips.interval))
                    stored.append(np.array(table[f"{slope}{body}"])[2:-2])
            yield slope, np.concatenate(measured), np.concatenate(stored)


@pytest.mark.parametrize("name", SCENES.ours())
def test_stored_derivatives_are_the_slopes_of_the_stored_states(name):
    scene = SCENES[name]()
    if isinstance(scene, BathScene):  # without noise, friction and drive are left
        scene = replace(scene, dt=STEP, sample=partial(cold, scene.sample))
    kinked = scene.box is not None  # where disks touch, a slope has a kink or a jump
    for slope, measured, stored in pairs_of(scene, LONG if kinked else SHORT):
        bounced = scene.derivatives_without == "bounces" and slope.startswith("f")
        assert (stored == 0).all() if bounced else np.abs(stored).max() > 0.1
        near = np.abs(measured - stored) <= WITHIN * (np.abs(stored).max() or 1.0)
        assert near.mean() >= (0.95 if kinked else 1.0), (slope, near.mean())


def test_a_port_drifts_as_its_own_step_does():
    rng = Generator().manual_seed(0)
    q, p = (torch.randn(4, 3, 2, generator=rng, dtype=torch.float64) for _ in range(2))
    state, mass = PhaseState(q, p), 0.5 + torch.rand(4, 3, generator=rng, dtype=torch.float64)
    told = {"friction": 0.7, "temperature": 0.0, "drive": 0.2}
    params = Parameters(torch.ones(4).double(), mass)
    for name, value in told.items():
        params = params.with_scalar(name, value)
    torch.manual_seed(0)
    frictions = [Friction(law, "known") for law in ("linear", "square", "dry")]
    baths = [ExactBath(), DrivenBath(3, 2), FullBath(3, 2)]
    for port in (*frictions, *baths, LinearFriction()):
        port.double()
        with torch.no_grad():
            moved = [port.kick(state, params, sign * 1e-6) for sign in (1, -1)]
            drift = port.drift(state, params)
        assert float(drift.norm()) > 0.1
        torch.testing.assert_close(drift, (moved[0] - moved[1]) / 2e-6, atol=1e-8, rtol=1e-7)


def made_by(tmp_path, scene: str, world: str = "rgb", seed: int = 0):
    settings = RenderSettings(scene, world, 2, 4, 2, 16, seed)
    run = RunFolder.open(tmp_path, {"cells": [], "seeds": [seed]})
    return read_manifest(render_folder(run, settings))


def test_noise_is_said_to_be_left_out_and_comes_again_with_its_seed(tmp_path):
    manifest = made_by(tmp_path / "a", "driven")
    assert manifest.derivatives_without == "noise of the bath" and not manifest.conserving
    torch.rand(3)  # what else was drawn in the process does not matter
    assert made_by(tmp_path / "b", "driven") == manifest
    assert made_by(tmp_path / "c", "driven", seed=1).clips != manifest.clips
    assert made_by(tmp_path / "d", "gravity").derivatives_without is None


def test_angles_are_drawn_at_the_ends_of_their_links_and_their_truth_keeps_them(tmp_path):
    made_by(tmp_path, "pendulum-linear")
    truth = pq.read_table(tmp_path / "truth" / "00000.parquet").to_pandas()
    labels = read_csv(tmp_path / "clips" / "00000.csv")
    q1, q2 = truth.q1, truth.q1 + truth.q2
    np.testing.assert_allclose(truth.x2, -np.sin(q1) - np.sin(q2), atol=1e-12)
    np.testing.assert_allclose(truth.y2, -np.cos(q1) - np.cos(q2), atol=1e-12)
    np.testing.assert_allclose(labels[["x1", "y2"]], truth[["x1", "y2"]], atol=1e-6)
    assert not {"vx1", "px1"} & set(truth.columns)


def test_disks_are_drawn_where_they_come_in_again():
    scene = SCENES["disks-soft"]()
    out = torch.tensor([[4.5, -0.5], [2.0, 9.0]]).double()
    assert scene.place(out).tolist() == [[-1.5, 1.5], [0.0, -1.0]]


def line() -> Scene:
    """A scene of three coordinates, which does not say where they are drawn."""
    return replace(gravity(), space=3, sample=lambda n, rng: (_flat(n), None))


def _flat(n: int) -> PhaseState:
    return PhaseState(torch.zeros(n, 3, 3), torch.zeros(n, 3, 3))


@pytest.mark.parametrize(
    ("scene", "world", "said"),
    [
        (f"{__name__}:line", "rgb", r"only bodies in a plane can be drawn.*3 coordinate"),
        ("crowd", "channels", "3 colours.*6 bodies; use the world anonymous"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_reason(scene, world, said):
    with pytest.raises(InputError, match=said):
        RenderSettings(scene, world, 2, 4, 2, 16, 0)
