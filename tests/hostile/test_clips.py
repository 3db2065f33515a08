"""Z8: a clip that a stranger made is decoded apart, within limits; the process that asks lives."""

from __future__ import annotations

import struct
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from vidphys.data import frames, memory
from vidphys.data.formats import child, opencv
from vidphys.data.formats.opencv import read_clip
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

FRAMES, RATE = 12, 25.0


def clip_at(path: Path, codec: str = "MJPG", frames: int = FRAMES, side: int = 64) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), RATE, (side, side))
    random = np.random.default_rng(0)
    for _ in range(frames):
        writer.write(random.integers(0, 256, (side, side, 3), dtype=np.uint8))
    writer.release()
    return path


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("good")
    return {
        suffix: clip_at(folder / f"a{suffix}", codec).read_bytes()
        for suffix, codec in ((".avi", "MJPG"), (".mp4", "mp4v"))
    }


def patched(data: bytes, mark: bytes, offset: int, value: bytes) -> bytes:
    at = data.index(mark) + len(mark) + offset
    return data[:at] + value + data[at + len(value) :]


def of_avi(data: bytes, width: int, height: int) -> bytes:
    """With other sizes in both of its headers."""
    data = patched(data, b"avih", 4 + 32, struct.pack("<II", width, height))
    return patched(data, b"strf", 4 + 4, struct.pack("<II", width, height))


def raw(data: bytes) -> bytes:
    """Said to be of plain pixels, as many as its headers say."""
    data = patched(data, b"strf", 4 + 14, struct.pack("<HI", 24, 0))
    return patched(data, b"vids", 0, bytes(4))


def wav() -> bytes:
    sound = b"\0\1" * 8000
    form = struct.pack("<HHIIHH", 1, 1, 8000, 16000, 2, 16)
    body = b"WAVEfmt " + struct.pack("<I", 16) + form + b"data" + struct.pack("<I", 16000) + sound
    return b"RIFF" + struct.pack("<I", len(body)) + body


CORPUS = {
    "empty.mp4": lambda good: b"",
    "text.mp4": lambda good: b"t,x,y\n0,1,2\n" * 50,
    "no-index.mp4": lambda good: good[".mp4"][: len(good[".mp4"]) // 2],
    "half.avi": lambda good: good[".avi"][: len(good[".avi"]) // 2],
    "bad-header.avi": lambda good: b"\0" * 64 + good[".avi"][64:],
    "huge.avi": lambda good: of_avi(raw(good[".avi"]), 65535, 65535),
    "large.avi": lambda good: of_avi(raw(good[".avi"]), 6300, 6300),
    "other-size.avi": lambda good: of_avi(good[".avi"], 65535, 65535),
    "no-rate.avi": lambda good: patched(good[".avi"], b"vids", 16, bytes(8)),
    "no-scale.mp4": lambda good: patched(good[".mp4"], b"mdhd", 12, bytes(4)),
    "before.mp4": lambda good: patched(good[".mp4"], b"mdhd", 16, b"\xff\xff\xff\xf0"),
    "sound.avi": lambda good: wav(),
    "list.mp4": lambda good: b"ffconcat version 1.0\nfile good.mp4\n",
    "list.avi": lambda good: b"#EXTM3U\n#EXTINF:1,\ngood.mp4\n#EXT-X-ENDLIST\n",
    "session.mov": lambda good: b"v=0\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
    "noise.mkv": lambda good: np.random.default_rng(0).bytes(20000),
}


@pytest.mark.parametrize("name", CORPUS)
def test_z08_a_clip_that_is_none_is_one_line_or_its_frames(tmp_path, good, name):
    (tmp_path / "good.mp4").write_bytes(good[".mp4"])
    path = tmp_path / name
    path.write_bytes(CORPUS[name](good))
    began = time.monotonic()
    try:
        video = open_video(path, ClipSelection())
        assert video.frames.shape[1:] == (64, 64, 3)
        assert len(video.frames) <= FRAMES
        assert name in (
            "other-size.avi",
            "half.avi",
            "no-rate.avi",
            "no-scale.mp4",
            "before.mp4",
            "bad-header.avi",
        )
    except InputError as error:
        assert str(path) in str(error)
        assert "\n" not in str(error)
    assert time.monotonic() - began < 10


def test_z08_the_sibling_of_a_list_is_a_clip_by_itself(tmp_path, good):
    (tmp_path / "good.mp4").write_bytes(good[".mp4"])
    assert len(open_video(tmp_path / "good.mp4", ClipSelection()).frames) == FRAMES


def test_z08_frames_are_those_of_decoding_in_this_process(tmp_path, good):
    for suffix, data in good.items():
        path = tmp_path / f"a{suffix}"
        path.write_bytes(data)
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        rate, count, frames = read_clip(path)
        assert (rate, count) == (RATE, FRAMES)
        for frame, stamp in frames:
            there, expected = capture.read()
            assert there
            assert np.array_equal(frame, expected[..., ::-1])
            assert stamp == capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        assert not capture.read()[0]


@pytest.mark.parametrize(
    ("limit", "value", "said"),
    [
        ("MEMORY", 2**20, "not a video"),
        ("MAX_PIXELS", 64 * 63, "frames of 64 x 64 pixels, more than 4032"),
        ("PATIENCE", 0.001, "hangs"),
    ],
)
def test_z08_a_limit_ends_the_child_and_is_said(tmp_path, good, monkeypatch, limit, value, said):
    monkeypatch.setattr(child if limit == "PATIENCE" else opencv, limit, value)
    (tmp_path / "a.mp4").write_bytes(good[".mp4"])
    with pytest.raises(InputError, match=said):
        open_video(tmp_path / "a.mp4", ClipSelection())


PROBE = """
import resource, socket, sys
sys.path.append({home!r})
from confined import allow, confine
confine(2**28)
allow(1)
failed = []
held = open("/dev/fd/0", "rb")
for what in (lambda: open({other!r}, "rb"), lambda: socket.socket(), lambda: bytearray(2**29)):
    try:
        what()
    except (OSError, MemoryError) as error:
        failed.append(type(error).__name__)
print(*failed, resource.getrlimit(resource.RLIMIT_CORE)[0], flush=True)
while True:
    pass
"""


def test_z08_what_decodes_has_no_other_file_no_socket_no_more_memory_and_no_time(tmp_path):
    other = tmp_path / "secret"
    other.write_text("x")
    code = PROBE.format(home=str(child.PROGRAMS), other=str(other))
    with Path(__file__).open("rb") as clip:
        done = subprocess.run(
            [sys.executable, "-I", "-c", code], stdin=clip, capture_output=True, timeout=30
        )
    assert done.stdout.split() == [b"OSError", b"OSError", b"MemoryError", b"0"]
    assert done.returncode == -24  # SIGXCPU


def children():
    tasks = Path("/proc/self/task").glob("*/children")
    return {pid for task in tasks for pid in task.read_text().split()}


def test_z08_nothing_is_left_behind_when_a_clip_is_not_read_to_its_end(tmp_path, good):
    (tmp_path / "a.avi").write_bytes(good[".avi"])
    before = children()
    _, _, frames = read_clip(tmp_path / "a.avi")
    next(frames)
    assert children() > before
    frames.close()
    assert children() == before


def test_z08_a_long_clip_is_not_held_and_no_more_than_is_free_at_once(tmp_path, monkeypatch):
    path = clip_at(tmp_path / "a.avi", frames=60, side=256)
    each = 256 * 256 * 3
    monkeypatch.setattr(frames, "HELD", 30 * each)
    monkeypatch.setattr(memory, "free_memory", lambda: 40 * each / memory.SHARE)
    video = open_video(path, ClipSelection())
    assert sum(len(block) for block in video.frames.chunks(10 * each)) == 60
    with pytest.raises(InputError, match="all frames at once fill 0.011 GiB, and no more than"):
        np.asarray(video.frames)
    assert np.asarray(video.frames[:40]).shape == (40, 256, 256, 3)


SCAN = """
import sys
from pathlib import Path
from vidphys.data import frames
from vidphys.data.video import ClipSelection, open_video

def most():
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024

frames.HELD = frames.RECENT = 2**21
clip = Path(sys.argv[1])
open_video(clip, ClipSelection(stop=2))
before = most()
video = open_video(clip, ClipSelection())
seen = sum(len(block) for block in video.frames.chunks(2**21)) + len(video.frames[-1:])
print(seen, most() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_z08_memory_does_not_grow_with_the_length_of_a_clip(tmp_path):
    path = clip_at(tmp_path / "a.avi", frames=400, side=256)  # 75 MiB of frames
    done = subprocess.run([sys.executable, "-c", SCAN, path], capture_output=True, check=True)
    seen, grown = done.stdout.split()
    assert int(seen) == 401 and float(grown) < 20


def test_z08_mutants_of_clips_are_frames_or_one_line(tmp_path, good):
    random = np.random.default_rng(8)
    path = tmp_path / "a.mp4"
    for number in range(12):
        data = bytearray(good[(".mp4", ".avi")[number % 2]])
        at = random.integers(0, len(data), 30)
        for k, value in zip(at, random.integers(0, 256, 30), strict=True):
            data[k] = value
        path.write_bytes(data)
        try:
            assert open_video(path, ClipSelection(rate=RATE)).frames.ndim == 4
        except InputError as error:
            assert str(path) in str(error)
