"""Reading clips: which frame it is, when it was, and what the container got wrong."""

from __future__ import annotations

import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from vidphys.data.video import ClipSelection, _times, open_video, require_frames
from vidphys.errors import InputError

FRAMES, RATE, BLOCK, BITS = 40, 25.0, 16, 6


def burned(index: int) -> np.ndarray:
    """A red-tinted BGR frame with its index in black and white blocks."""
    frame = np.full((48, BLOCK * BITS, 3), (20, 20, 200), np.uint8)
    for bit in range(BITS):
        frame[:BLOCK, bit * BLOCK : (bit + 1) * BLOCK] = 255 * (index >> bit & 1)
    return frame


def index_of(frame: np.ndarray) -> int:
    half = BLOCK // 2
    return sum(int(frame[half, b * BLOCK + half, 0] > 127) << b for b in range(BITS))


@pytest.fixture(scope="module", params=["MJPG.avi", "mp4v.mp4"])
def clip(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    codec, suffix = request.param.split(".")
    path = tmp_path_factory.mktemp("clips") / f"clip.{suffix}"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), RATE, (BLOCK * BITS, 48))
    for index in range(FRAMES):
        writer.write(burned(index))
    writer.release()
    return path


def test_every_frame_is_the_one_it_says(clip: Path) -> None:
    video = open_video(clip, ClipSelection())
    assert [index_of(f) for f in video.frames] == list(range(FRAMES)) == video.indices.tolist()
    assert video.frames.dtype == np.uint8
    np.testing.assert_allclose(np.diff(video.times), 1 / RATE, atol=1e-6)
    assert video.interval == pytest.approx(1 / RATE)
    assert video.notes == ()
    assert video.size == (48, BLOCK * BITS)


def test_a_clip_of_an_unknown_codec_is_refused_with_what_to_do(
    clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vidphys.data.video._decoding", lambda *_: (RATE, FRAMES, iter(())))
    with pytest.raises(InputError, match="none of its frames can be decoded: .*convert it"):
        open_video(clip, ClipSelection())


def test_channels_are_red_first(clip: Path) -> None:
    red, green, blue = open_video(clip, ClipSelection(stop=1)).frames[0][-8:].mean((0, 1))
    assert red > 150 > 60 > max(green, blue)


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        (ClipSelection(start=7), range(7, FRAMES)),
        (ClipSelection(stop=5), range(5)),
        (ClipSelection(start=3, stop=30, stride=4), range(3, 30, 4)),
        (ClipSelection(start=FRAMES - 1), range(FRAMES - 1, FRAMES)),
    ],
)
def test_selection(clip: Path, selection: ClipSelection, expected: range) -> None:
    video = open_video(clip, selection)
    assert [index_of(f) for f in video.frames] == list(expected) == video.indices.tolist()
    whole = open_video(clip, ClipSelection())
    np.testing.assert_array_equal(video.times, whole.times[list(expected)])
    assert video.notes == ()


def test_side_shrinks_and_keeps_the_picture(clip: Path) -> None:
    small = np.asarray(open_video(clip, ClipSelection(side=48)).frames)
    large = np.asarray(open_video(clip, ClipSelection()).frames)
    assert small.shape[1:] == (24, 48, 3)
    np.testing.assert_allclose(small.mean((1, 2)), large.mean((1, 2)), atol=2)
    assert open_video(clip, ClipSelection(side=500)).frames.shape == large.shape


def test_given_rate_replaces_the_stamps(clip: Path) -> None:
    video = open_video(clip, ClipSelection(rate=200.0, start=2))
    np.testing.assert_allclose(video.times, np.arange(2, FRAMES) / 200)
    assert "200" in video.notes[0]


def test_declared_and_decoded_count_disagree(tmp_path: Path) -> None:
    path = tmp_path / "whole.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), RATE, (96, 48))
    for index in range(FRAMES):
        writer.write(burned(index))
    writer.release()
    cut = tmp_path / "cut.avi"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    video = open_video(cut, ClipSelection())
    count = len(video.frames)
    assert 5 < count < FRAMES
    assert any(f"declares {FRAMES} frames, {count} were decoded" in n for n in video.notes)
    assert open_video(cut, ClipSelection(stop=3)).notes == ()


def test_stamps_that_do_not_increase_are_replaced() -> None:
    stamps = np.array([0.0, 0.1, 0.2, 0.0, 0.4, 0.5])
    times, notes = _times(Path("clip"), stamps, None)
    np.testing.assert_allclose(times, np.arange(6) * 0.1)
    assert "1 presentation stamps do not increase" in notes[0]
    with pytest.raises(InputError, match="give the frame rate as `rate`"):
        _times(Path("clip"), np.zeros(5), None)


@pytest.mark.parametrize(
    ("selection", "message"),
    [
        (ClipSelection(start=-1), "0 <= start < stop"),
        (ClipSelection(start=4, stop=4), "0 <= start < stop"),
        (ClipSelection(stride=0), "stride 0"),
        (ClipSelection(rate=0.0), "rate 0"),
        (ClipSelection(rate=float("nan")), "rate nan"),
        (ClipSelection(side=0), "side 0"),
        (ClipSelection(start=FRAMES), f"{FRAMES} were decoded"),
    ],
)
def test_bad_selection(clip: Path, selection: ClipSelection, message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_video(clip, selection)


def test_bad_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        open_video(tmp_path / "nowhere.mp4", ClipSelection())
    with pytest.raises(InputError, match="no such file"):
        open_video(tmp_path, ClipSelection())
    text = tmp_path / "text.mp4"
    for content in ("", "not a video " * 100):
        text.write_text(content)
        with pytest.raises(InputError, match="not a video"):
            open_video(text, ClipSelection())


def test_the_decoder_adds_no_lines_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "text.mp4"
    path.write_text("not a video " * 100)
    code = (
        "import sys; from pathlib import Path; from vidphys.data.video import *\n"
        "try: open_video(Path(sys.argv[1]), ClipSelection())\n"
        "except ValueError as error: print(error)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    assert run.stderr == ""
    assert run.stdout.count("\n") == 1


def test_one_frame_has_no_momentum(clip: Path) -> None:
    video = open_video(clip, ClipSelection(stop=1))
    assert len(video.frames) == 1
    with pytest.raises(InputError, match="needs at least 3 frames, the selection has 1"):
        require_frames(video)
    with pytest.raises(InputError, match="no frame interval"):
        _ = video.interval
    require_frames(open_video(clip, ClipSelection(stop=3)))


def test_real_clips() -> None:
    folder = os.environ.get("VIDPHYS_CLIPS")
    if folder is None or not (Path(folder) / "ball_bounce.avi").is_file():
        pytest.skip("VIDPHYS_CLIPS does not name a folder with ball_bounce.avi")
    bounce = open_video(Path(folder) / "ball_bounce.avi", ClipSelection())
    assert len(bounce.frames) == 295
    notes = "; ".join(bounce.notes)
    assert "declares 300 frames, 295 were decoded" in notes
    assert "declares 187.4 frames per second" in notes
    puck = open_video(Path(folder) / "puck_constant_force.avi", ClipSelection())
    assert len(puck.frames) == 26
    assert (np.diff(puck.times) > 0).all()


def write_with_av(
    path: Path,
    frames: np.ndarray,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    wide: Fraction = Fraction(1),
    container: str | None = None,
) -> None:
    """Write RGB ``frames (t, H, W, 3)``, 25 a second, whose pixels are so wide for their height."""
    import av

    with av.open(str(path), "w", format=container) as out:
        stream = out.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], pixels
        stream.codec_context.sample_aspect_ratio = wide
        for frame in frames:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        out.mux(stream.encode(None))


@pytest.mark.parametrize("wide, size", [("4/3", (96, 160)), ("8/9", (108, 120)), ("1", (96, 120))])
def test_a_ball_is_round_where_the_file_says_that_pixels_are_not_square(tmp_path, wide, size):
    across, down = np.meshgrid(np.arange(120), np.arange(96))
    ball = ((across - 60) * float(Fraction(wide))) ** 2 + (down - 48) ** 2 < 30**2
    frames = np.repeat(255 * ball[None, ..., None].astype(np.uint8), 3, -1).repeat(3, 0)
    write_with_av(tmp_path / "a.mp4", frames, wide=Fraction(wide))
    video = open_video(tmp_path / "a.mp4", ClipSelection())
    assert video.size == size
    seen = video.frames[1][..., 0] > 127
    assert abs(int(seen.any(0).sum()) - int(seen.any(1).sum())) <= 1


@pytest.mark.parametrize(
    "suffix, codec, pixels, container",
    [
        ("gif", "gif", "rgb8", None),
        ("mpg", "mpeg1video", "yuv420p", None),
        ("mpg", "mpeg1video", "yuv420p", "mpeg1video"),
        ("wmv", "wmv2", "yuv420p", None),
        ("flv", "flv1", "yuv420p", None),
        ("3gp", "mpeg4", "yuv420p", None),
        ("ts", "mpeg2video", "yuv420p", None),
        ("y4m", "wrapped_avframe", "yuv420p", "yuv4mpegpipe"),
        ("h264", "libx264", "yuv420p", "h264"),
    ],
)
def test_the_clips_of_old_cameras_and_of_pages_are_read(tmp_path, suffix, codec, pixels, container):
    across, down = np.meshgrid(np.arange(120), np.arange(96))
    balls = [(across - 40 - 4 * k) ** 2 + (down - 48) ** 2 < 20**2 for k in range(8)]
    frames = 255 * np.array(balls, np.uint8)[..., None].repeat(3, -1)
    write_with_av(tmp_path / f"a.{suffix}", frames, codec, pixels, container=container)
    stampless = suffix == "h264"
    video = open_video(tmp_path / f"a.{suffix}", ClipSelection(rate=25 if stampless else None))
    np.testing.assert_allclose(video.times, np.arange(8) / 25, atol=1e-3)
    assert not any("declares" in note for note in video.notes)
    for k in (0, 7):
        seen = video.frames[k][..., 0] > 127
        assert abs(across[seen].mean() - 40 - 4 * k) < 0.5
