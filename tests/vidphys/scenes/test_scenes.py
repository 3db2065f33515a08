"""S1: the generators, the float64 truth, its certificate and its Lyapunov time."""

import pytest
import torch
from torch import Generator

from dynamics import Parameters, PhaseState
from renderers import Camera, ChannelWorld
from vidphys.data.clips import render_clips
from vidphys.errors import InputError
from vidphys.scenes import certify, gravity, lyapunov_time
from vidphys.seeding import derive


def sample(name: str, episodes: int = 200):
    scene = gravity(name)
    return scene, *scene.sample(episodes, Generator().manual_seed(1))


@pytest.mark.parametrize("name", ["gaussian", "ring"])
def test_generators_keep_their_ranges_and_centre_of_mass(name):
    _, start, params = sample(name)
    assert start.q.dtype == torch.float64
    assert (params.coupling > 0).all()
    assert ((params.mass >= 0.5) & (params.mass <= 1.5)).all()
    torch.testing.assert_close(start.p.sum(1), torch.zeros(200, 2).double(), atol=1e-14, rtol=0)


def test_gaussian_has_the_stated_spread():
    _, start, params = sample("gaussian", 4000)
    assert float(start.q.std()) == pytest.approx(1.0, rel=0.03)
    # Removing the total momentum takes a third of three bodies' velocity variance, on average.
    speed = (start.p / params.mass[..., None]).std()
    assert 0.35 < float(speed) < 0.5


def test_unknown_generator_is_named():
    with pytest.raises(InputError, match="gaussian, ring"):
        gravity("rnig")


def test_reference_drift_is_the_papers_order_of_magnitude():
    scene, start, params = sample("gaussian", 64)
    rolled = scene.simulate(start, params, 2000, 10)
    checked = certify(scene, rolled)
    # The study says "about 0.01" of the largest drift over time.
    assert 1e-4 < float(checked.drift.median()) < 2e-2
    assert checked.finite.all()


def test_certificate_sees_a_body_that_leaves_and_a_wild_energy():
    scene, start, params = sample("gaussian", 4)
    rolled = scene.simulate(start, params, 20)
    assert certify(scene, rolled, half_extent=10.0).passed.all()
    rolled.states.q[1, -1, 0, 0] = 11.0
    assert certify(scene, rolled, half_extent=10.0).in_frame.tolist() == [True, False, True, True]
    rolled.states.p[2, -1] *= 30
    assert not certify(scene, rolled).passed[2]


def test_energy_of_two_bodies_by_hand():
    scene = gravity(bodies=2)
    q = torch.tensor([[[[0.0, 0.0], [3.0, 4.0]]]], dtype=torch.float64)
    p = torch.tensor([[[[1.0, 0.0], [-1.0, 0.0]]]], dtype=torch.float64)
    mass = torch.tensor([[2.0, 4.0]], dtype=torch.float64)
    params = Parameters(torch.tensor([1.5], dtype=torch.float64), mass)
    expected = 1 / 4 + 1 / 8 - 1.5 * 8 / (25 + 0.01) ** 0.5
    assert float(scene.energy(PhaseState(q, p), params)) == pytest.approx(expected, rel=3e-15)


def test_gravity_is_chaotic_and_free_motion_is_not():
    scene, start, params = sample("gaussian", 8)
    chaotic = lyapunov_time(scene, start, params)
    free = lyapunov_time(scene, start, params.with_coupling(0.0))
    assert 0.1 < float(chaotic.median()) < 8
    # Without a force an offset grows linearly: log(21 / 6) over 15 s is all that is left of it.
    assert float(free.median()) == pytest.approx(15 / 1.253, rel=0.05)


def test_clips_stay_in_frame_and_repeat_with_their_seed():
    scene = gravity(mass=(1.0, 1.0))
    world = ChannelWorld(Camera(height=16, width=16))
    made = [render_clips(scene, world, 12, 5, 40, 3, "train") for _ in range(2)]
    assert torch.equal(made[0].frames, made[1].frames)
    assert made[0].frames.shape == (12, 5, 3, 16, 16) and made[0].frames.dtype == torch.uint8
    assert float(made[0].states.q.abs().max()) < 4.0
    assert made[0].interval == pytest.approx(0.08, rel=3e-15)
    other = render_clips(scene, world, 12, 5, 40, 3, "test")
    assert not torch.equal(made[0].frames, other.frames)


def test_a_camera_that_sees_nothing_is_an_error():
    world = ChannelWorld(Camera(half_extent=0.05, height=8, width=8), sigma=0.01)
    with pytest.raises(InputError, match="widen the camera"):
        render_clips(gravity(), world, 4, 3, 40, 0, "train")


def test_seeds_differ_by_every_name():
    seeds = {derive(s, *names) for s in (0, 1) for names in ((), ("a",), ("a", "b"), ("ab",))}
    assert len(seeds) == 8
