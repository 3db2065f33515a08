"""What bodies look like is measured from pictures alone, well enough to find them by."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from binders.palette import PaletteSettings
from renderers import AnonymousWorld, Camera, RgbWorld
from vidphys.data.clips import Clips, render_clips
from vidphys.errors import InputError
from vidphys.perception.base import FitTask
from vidphys.perception.blobs import BlobSettings, Profile, measured_colours, measured_world
from vidphys.perception.detections import FixedDetector
from vidphys.perception.palette import PaletteTracking, fit_palette
from vidphys.presets import PixelSizes
from vidphys.scenes import gravity

CAMERA = Camera(height=64, width=64)
SCENE = gravity(mass=(1.0, 1.0))


def clips_of(world) -> Clips:
    return render_clips(SCENE, world, 24, 8, 40, 0, "train")


@pytest.fixture(scope="module")
def anonymous() -> Clips:
    return clips_of(AnonymousWorld(CAMERA))


def test_a_profile_goes_through_what_falls_and_ends_dark():
    squared, light = np.array([0.0, 1.0, 2.0, 4.0]), np.array([0.9, 0.5, 0.6, 0.1])
    profile = Profile.through(squared, light)
    at = torch.tensor([0.0, 1.0, 2.0, 4.0, 9.0], dtype=torch.float64, requires_grad=True)
    found = profile(at)
    assert found.tolist() == pytest.approx([0.9, 0.5, 0.5, 0.0, 0.0], abs=1e-6)
    fine = torch.linspace(0, 5, 101)
    assert bool((profile(fine).diff() <= 1e-6).all())
    (slope,) = torch.autograd.grad(found.sum(), at)
    step = 1e-3
    near = (profile(at.detach() + step) - profile(at.detach() - step)) / (2 * step)
    assert torch.allclose(slope[1:3], near[1:3], atol=1e-2)


@pytest.mark.parametrize(("radius", "softness"), [(0.6, 0.05), (0.4, 0.15)])
def test_the_look_of_a_blob_is_that_of_the_renderer_though_nobody_told_it(radius, softness):
    clips = clips_of(AnonymousWorld(CAMERA, radius, softness))
    world = measured_world(clips)
    distance = torch.linspace(0, 1.2 * radius, 40)
    own = clips.world.coverage(distance**2)
    assert float((world.coverage(distance**2) - own).abs().max()) < 0.05
    q = clips.states.q[0, :2].float()
    assert float((world(q) - clips.world(q)).square().mean().sqrt()) < 0.02


def test_a_detector_that_knows_blobs_alone_finds_them_without_the_world(anonymous, monkeypatch):
    world = measured_world(anonymous)
    few = anonymous.first(4)
    monkeypatch.setattr(AnonymousWorld, "coverage", None)  # nothing of the renderer is asked
    found = FixedDetector(world=world)(few)
    apart = torch.cdist(found.positions.double(), few.states.q)
    assert float(apart.amin(-1).median()) < 2e-3 and float(apart.amin(-1).mean()) < 0.02


def test_a_measured_world_reads_no_state(anonymous):
    states = anonymous.states.map(lambda x: torch.full_like(x, torch.nan))
    blind = measured_world(replace(anonymous, states=states))
    assert torch.equal(blind.coverage.terms, measured_world(anonymous).coverage.terms)


def test_colours_are_measured_and_numbered_by_hue():
    palette = ((0.1, 0.8, 0.2), (0.2, 0.1, 0.9), (0.9, 0.3, 0.1))  # green, blue, red
    clips = clips_of(RgbWorld(CAMERA, palette=palette))
    colours = measured_colours(clips)
    order = [2, 0, 1]
    for found, body in zip(colours.palette, order, strict=True):
        whole = torch.tensor(found) / torch.tensor(found).norm()
        true = torch.tensor(palette[body]) / torch.tensor(palette[body]).norm()
        assert float(whole @ true) > 0.99
    tracks = PaletteTracking(PaletteSettings(in_order=False), colours).tracks(clips.first(4))
    error = (tracks.positions - clips.first(4).states.q[:, :, order]).norm(dim=-1)
    assert float(error.median()) < 5e-3


@pytest.mark.parametrize("blobs", [False, True])
def test_colours_are_measured_only_by_whom_nobody_told_them(blobs, monkeypatch):
    clips, measured = render_clips(SCENE, RgbWorld(CAMERA), 1, 2, 40, 0, "train"), object()
    monkeypatch.setattr("vidphys.perception.palette.measured_colours", lambda _: measured)
    fitted = fit_palette(
        FitTask(clips, PixelSizes(1, 2, 40, 64, 1, 1, 0, 1), 0, "factored"), blobs=blobs
    )
    assert fitted.seen is (measured if blobs else None)
    assert fitted.settings.in_order == (not blobs)


def test_too_few_blobs_that_stand_alone_are_named(anonymous):
    with pytest.raises(InputError, match="stand alone in .* frames, and 99999 are needed"):
        measured_world(anonymous, BlobSettings(least=99999))
    one = replace(anonymous, frames=torch.zeros_like(anonymous.frames))
    with pytest.raises(InputError, match="blobs: 0 bodies stand alone"):
        measured_world(one)
