"""Pictures of any shape before a network of squares: what it is shown, and where its cells lie."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import timm
import torch
import transformers as hub
from PIL import Image

from encoders.features import FeatureMap
from encoders.frozen import load_encoder
from encoders.preprocess import Fitting, Look
from encoders.store import FeatureStore
from vidphys.data.extraction import extract, pictures
from vidphys.data.many import Wanted, extract_many
from vidphys.data.video import ClipSelection, open_video

TIMES = torch.arange(2, dtype=torch.float64) / 25


def picture(height, width):
    """One that bends slowly, so that filters differ little."""
    y, x = np.mgrid[0:height, 0:width] / 20
    waves = [np.sin(x + y), np.cos(x - y), np.sin(2 * x)]
    return np.uint8(127 + 100 * np.stack(waves, -1))


def shown(fitting, frame, look):
    clip = torch.from_numpy(frame).permute(2, 0, 1)[None, None].float() / 255
    return fitting.pixels(clip, look, torch.float32)[0, 0]


@pytest.mark.parametrize(("height", "width"), [(90, 160), (160, 90), (72, 72)])
def test_a_crop_is_what_the_processor_of_transformers_takes(height, width):
    processor = hub.CLIPImageProcessor(size={"shortest_edge": 36}, crop_size=32, resample=3)
    mean, std = tuple(processor.image_mean), tuple(processor.image_std)
    fitting = Fitting("crop", 32, before=36)
    ours = shown(fitting, picture(height, width), Look(mean, std, "bicubic"))
    theirs = processor(Image.fromarray(picture(height, width)), return_tensors="pt")
    torch.testing.assert_close(ours, theirs["pixel_values"][0], atol=0.05, rtol=0)


def test_a_crop_of_timm_is_its_transforms():
    encoder = load_encoder("timm:test_vit", {"seed": 0, "resolution": 64, "fit": "crop"})
    data = timm.data.resolve_model_data_config(encoder.network)
    theirs = timm.data.create_transform(**{**data, "input_size": (3, 64, 64)})
    frame = picture(90, 162)
    ours = shown(encoder.fitting, frame, encoder.look)
    # as centred as can be: timm cuts half a pixel off the middle
    close = (ours - theirs(Image.fromarray(frame))).abs()
    assert float(close.mean()) < 0.02 and float(close.max()) < 0.1


def spotted(height, width, row, column):
    """Two frames that are dark but for a spot, and its place in the units of cell centres."""
    clip = torch.zeros(1, 2, 3, height, width)
    clip[..., row - 3 : row + 3, column - 3 : column + 3] = 1
    half = max(height, width) / 2
    return clip, ((column - width / 2) / half, (height / 2 - row) / half)


def brightest(encoder, clip):
    """The place of the cell that the spot changes most."""
    seen, blank = (encoder(frames, TIMES) for frames in (clip, torch.zeros_like(clip)))
    changed = (seen.values - blank.values)[0, 0].norm(dim=0).flatten()
    return seen.cell_centres().flatten(0, 1)[changed.argmax()], seen


@pytest.mark.parametrize("fit", ["squash", "crop", "pad", "keep"])
@pytest.mark.parametrize(("height", "width"), [(90, 160), (160, 90), (96, 96)])
def test_cells_lie_where_the_whole_picture_has_them(fit, height, width):
    options = {"seed": 0, "resolution": 96, "fit": fit, "layer": 1}
    encoder = load_encoder("timm:test_convnext", options)
    for down, right in ((-20, -30), (28, 15), (0, 0)):
        row, column = height // 2 + down, width // 2 + right
        clip, place = spotted(height, width, row, column)
        found, features = brightest(encoder, clip)
        cell = max(features.stride[:2]) / (max(height, width) / 2)
        assert float((found - torch.tensor(place)).abs().max()) < 0.75 * cell, (row, column)
        assert features.grid == tuple(features.values.shape[-2:])


def test_what_a_crop_leaves_out_changes_nothing_and_no_cell_lies_there():
    encoder = load_encoder("timm:test_convnext", {"seed": 0, "resolution": 96, "fit": "crop"})
    clip, _ = spotted(90, 160, 45, 10)
    blank = encoder(torch.zeros_like(clip), TIMES)
    torch.testing.assert_close(encoder(clip, TIMES).values, blank.values)
    assert float(blank.cell_centres()[..., 0].abs().max()) < 90 / 160
    squashed = load_encoder("timm:test_convnext", {"seed": 0, "resolution": 96, "fit": "squash"})
    assert not torch.equal(squashed(clip, TIMES).values, blank.values)


def test_a_padded_picture_keeps_its_shape_and_cells_of_the_filling_are_left_out():
    padded, kept = (
        load_encoder("timm:test_efficientnet", {"seed": 0, "resolution": 96, "fit": fit})
        for fit in ("pad", "keep")
    )
    clip = torch.rand(1, 2, 3, 96, 48, generator=torch.Generator().manual_seed(0))
    for layer in padded.layers:
        one, two = (each.at(layer)(clip, TIMES) for each in (padded, kept))
        assert one.values.shape == two.values.shape and one.stride == two.stride
    whole = torch.rand(1, 2, 3, 96, 96, generator=torch.Generator().manual_seed(0))
    assert torch.equal(padded(whole, TIMES).values, kept(whole, TIMES).values)


def test_a_crop_of_a_clip_has_its_places_in_a_store_too(tmp_path):
    path = tmp_path / "wide.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (160, 90))
    for _ in range(3):
        film.write(picture(90, 160))
    film.release()
    video = open_video(path, ClipSelection())
    encoder = load_encoder("timm:test_vit", {"seed": 0, "resolution": 64, "fit": "crop"})
    frames = torch.cat([*pictures(video.frames)])[None]
    told = encoder(frames, torch.from_numpy(video.times))
    assert len(told.stride) == 4 and told.stride[3] > 0
    many = Wanted(encoder, encoder.layers[-1:], FeatureStore(tmp_path / "many"), "float32")
    extract_many([video], many, lambda video, made: None)
    (request,) = many.requests(video).values()
    alone = FeatureStore(tmp_path / "alone")
    single = extract(video, encoder, alone, "float32").features
    copied = FeatureStore(tmp_path / "copied")
    copied.write(request, "a clip", many.store.arrays(request))
    many.store.pack()
    for found in (single, many.store.read(request), copied.read(request)):
        assert isinstance(found, FeatureMap) and found.stride == pytest.approx(told.stride)
        torch.testing.assert_close(found.cell_centres(), told.cell_centres())


def test_a_network_of_squares_is_given_no_other_shape():
    for name, fit, said in (
        ("timm:hiera_tiny_224", "keep", "takes squares only"),
        ("torchvision:s3d", "keep", "takes squares only"),
    ):
        with pytest.raises(ValueError, match=said):
            load_encoder(name, {"seed": 0, "fit": fit})
