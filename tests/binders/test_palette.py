"""The palette tracker: unmixing, occlusion, local paths, and what it refuses."""

import pytest
import torch
from torch import Generator

from binders.palette import local_paths, track_by_palette, unmix
from renderers import AnonymousWorld, Camera, RgbWorld
from renderers.splats import disk_coverage
from vidphys.data.clips import render_clips
from vidphys.errors import InputError
from vidphys.perception.palette import PaletteTracking
from vidphys.scenes import gravity

CAMERA = Camera(height=64, width=64)
WORLD = RgbWorld(CAMERA)
TIMES = 0.08 * torch.arange(9.0)


def coverage(squared):
    return disk_coverage(squared, WORLD.radius, WORLD.softness)


def track(frames, bodies=3):
    return track_by_palette(
        frames, TIMES[: frames.shape[1]], WORLD.palette[:bodies], coverage, CAMERA.xs(), CAMERA.ys()
    )


def passing(depth_gap=0.1):
    """Body 1 passes behind body 0 on a bent path; body 2 stands aside. ``(1, 9, 3, 2)``."""
    t = torch.linspace(-1, 1, 9)
    moving = torch.stack([1.2 * t, depth_gap + 0.3 * t**2], -1)
    still = torch.zeros(9, 2)
    aside = torch.tensor([2.0, -2.0]).expand(9, 2)
    return torch.stack([still, moving, aside], 1).unsqueeze(0)


def test_bodies_are_found_to_a_hundredth_of_a_pixel_where_they_are_seen():
    q = 3 * (2 * torch.rand(20, 1, 3, 2, generator=Generator().manual_seed(0)) - 1)
    tracks = track(WORLD(q))
    error = (tracks.positions - q).norm(dim=-1)
    seen = tracks.confidence > 0.9
    assert int(seen.sum()) > 40
    assert float(error[seen].max()) < 0.01 * CAMERA.units_per_pixel


def test_a_body_behind_another_is_followed():
    q = passing()
    tracks = track(WORLD(q))
    hidden = tracks.confidence[0, :, 1] < 0.5
    assert bool(hidden.any()) and float(tracks.confidence[0, :, 0].min()) > 0.99
    error = (tracks.positions - q).norm(dim=-1)[0]
    assert float(error[:, 0].max()) < 1e-3 and float(error[:, 1].max()) < 0.03
    # What is visible of it has its centre far from the body's.
    visible = unmix(WORLD(q), WORLD.palette[:3])[0, 4, 1]
    x = (visible.sum(0) * CAMERA.xs()).sum() / visible.sum()
    y = (visible.sum(1) * CAMERA.ys()).sum() / visible.sum()
    assert float((torch.stack([x, y]) - q[0, 4, 1]).norm()) > 0.1


def test_a_body_that_no_pixel_shows_lies_on_its_path_with_no_confidence():
    q = passing()
    gone = q.clone()
    gone[0, 4, 2] = 100.0  # for one frame it is nowhere
    tracks = track(WORLD(gone))
    assert float(tracks.confidence[0, 4, 2]) == 0
    assert float((tracks.positions[0, 4, 2] - q[0, 4, 2]).norm()) < 1e-3


def test_unmixing_gives_what_the_renderer_left_visible():
    q = passing()
    visible = unmix(WORLD(q), WORLD.palette[:3])
    alone = WORLD(q[:, :, 1:2])[:, :, 0]  # body 1 drawn alone, in the first colour
    front = WORLD(q[:, :, :1])[:, :, 0]
    torch.testing.assert_close(visible[:, :, 1], alone * (1 - front), atol=1e-5, rtol=0)


def test_colours_that_mix_are_refused():
    with pytest.raises(ValueError, match="4 colours of which only 3 are independent"):
        unmix(torch.zeros(3, 8, 8), WORLD.palette[:4])


def test_a_pixel_that_is_not_finite_is_named():
    frames = WORLD(passing())
    frames[0, 3, 0, 5, 5] = torch.nan
    with pytest.raises(ValueError, match="clip 0, frame 3"):
        track(frames)


def test_a_local_path_is_exact_for_cubics_and_ignores_one_wrong_frame():
    t = TIMES.double()
    q = torch.stack([1 + t - 2 * t**2 + 5 * t**3, 3 * t], -1)[None, :, None]
    weight = torch.ones(1, 9, 1, dtype=torch.float64)
    torch.testing.assert_close(local_paths(q, weight, t), q, atol=1e-4, rtol=0)
    bent = q.clone()
    bent[0, 4] += 1.0
    paths = local_paths(bent, weight, t)
    assert float((paths - q)[0, 4].norm()) < 0.05
    weight[0, 4] = 0
    torch.testing.assert_close(local_paths(bent, weight, t)[0, 4], q[0, 4], atol=1e-3, rtol=0)


def test_the_rung_follows_rendered_clips_and_refuses_other_worlds():
    scene = gravity(mass=(1.0, 1.0))
    clips = render_clips(scene, WORLD, 6, 9, 40, 0, "train")
    tracks = PaletteTracking().tracks(clips)
    error = (tracks.positions - clips.states.q).norm(dim=-1)
    assert float(error.median()) < 1e-3
    other = render_clips(scene, AnonymousWorld(CAMERA), 2, 9, 40, 0, "train")
    with pytest.raises(InputError, match="rgb-tracked.*AnonymousWorld"):
        PaletteTracking().tracks(other)
