"""Pictures one after the other in one file: TIFF stacks, animated WebP and PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vidphys.data.formats.stacks import is_stack
from vidphys.data.listed import clips_at
from vidphys.data.sets import only_clip
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

FRAMES, SIZE = 6, (20, 30)
IMAGEJ = {270: "ImageJ=1.54f\nimages=6\nframes=6\nfinterval=0.05\nloop=false\n"}


def shades(kind: type, most: float) -> np.ndarray:
    """Pictures ``(t, h, w)`` in which a bright square moves; ever brighter."""
    held = np.zeros((FRAMES, *SIZE))
    for t, picture in enumerate(held):
        picture[5:11, 3 + 3 * t : 9 + 3 * t] = most * (t + 1) / FRAMES
    return held.astype(kind)


def stack(path: Path, pictures: np.ndarray, **options) -> Path:
    first, *rest = [Image.fromarray(picture) for picture in pictures]
    first.save(path, save_all=True, append_images=rest, **options)
    return path


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "tiff_adobe_deflate"])
def test_a_tiff_stack_of_bytes_is_a_clip_with_the_interval_of_imagej(tmp_path, compression) -> None:
    pictures = shades(np.uint8, 250)
    path = stack(tmp_path / "a.tif", pictures, compression=compression, tiffinfo=IMAGEJ)
    video = open_video(path, ClipSelection())
    np.testing.assert_allclose(video.times, 0.05 * np.arange(FRAMES))
    np.testing.assert_array_equal(video.frames[:], np.repeat(pictures[..., None], 3, -1))
    assert video.decoder.startswith("pillow ")
    assert list(clips_at(tmp_path)) == [path]


@pytest.mark.parametrize(("kind", "most"), [(np.uint16, 4095), (np.float32, 3.5)])
def test_other_values_are_shown_between_the_least_and_the_most_of_all(tmp_path, kind, most) -> None:
    path = stack(tmp_path / "a.tiff", shades(kind, most))
    with pytest.raises(InputError, match="give the frames per second as `rate`"):
        open_video(path, ClipSelection())
    video = open_video(path, ClipSelection(rate=10.0))
    bright = [int(frame.max()) for frame in video.frames]
    np.testing.assert_allclose(bright, 255 * np.arange(1, FRAMES + 1) / FRAMES, atol=1)
    assert video.times[-1] == 0.5


@pytest.mark.parametrize("name", ["a.webp", "a.png"])
def test_an_animation_has_the_times_of_its_frames(tmp_path, name) -> None:
    lasts = [40, 40, 80, 40, 40, 40]
    pictures = np.repeat(shades(np.uint8, 250)[..., None], 3, -1)
    video = open_video(
        stack(tmp_path / name, pictures, duration=lasts, lossless=True), ClipSelection()
    )
    np.testing.assert_allclose(video.times, [0, 0.04, 0.08, 0.16, 0.2, 0.24])
    np.testing.assert_array_equal(video.frames[:], pictures)


def test_one_picture_is_no_stack_and_a_folder_of_them_stays_a_clip(tmp_path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for t, picture in enumerate(shades(np.uint8, 250)):
        Image.fromarray(picture).save(folder / f"{t:03}.tif")
        assert not is_stack(folder / f"{t:03}.tif")
    video = open_video(only_clip(folder), ClipSelection(rate=5.0))
    assert video.frames.shape == (FRAMES, *SIZE, 3)
    for name in ("a.png", "a.webp"):
        Image.new("RGB", (9, 9)).save(tmp_path / name)
        assert not is_stack(tmp_path / name)


def test_a_hurt_stack_is_refused_in_one_line(tmp_path) -> None:
    whole = stack(tmp_path / "a.tif", shades(np.uint8, 250), compression="tiff_lzw").read_bytes()
    rng, path = np.random.default_rng(0), tmp_path / "hurt.tif"
    for _ in range(8):
        hurt = bytearray(whole)
        for place in rng.integers(8, len(hurt), 6):
            hurt[place] = rng.integers(256)
        path.write_bytes(hurt)
        try:
            assert open_video(path, ClipSelection(rate=5.0)).frames.shape[-1] == 3
        except InputError as error:
            assert "\n" not in str(error)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError):
        open_video(path, ClipSelection(rate=5.0))
