"""Frames that are decoded as they are asked for are those of the clip held whole."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from vidphys.cli.recordings import write_tracks_recording
from vidphys.data import frames as module
from vidphys.data.frames import Frames, Source, held
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

COUNT = 23


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clips") / "a.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (48, 32))
    for seed in range(COUNT):
        writer.write(np.random.default_rng(seed).integers(0, 256, (32, 48, 3), np.uint8))
    writer.release()
    return path


@pytest.fixture
def decodings(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """No clip is held; grows by one at each decoding."""
    begun: list[int] = []
    monkeypatch.setattr(module, "HELD", 0)
    monkeypatch.setattr(module, "RECENT", 3 * 48 * 32 * 3)
    each = Source.__init__

    def counted(self, decode, *rest):  # noqa: ANN001, ANN002, ANN202
        def again():  # noqa: ANN202
            begun.append(1)
            return decode()

        each(self, again, *rest)

    monkeypatch.setattr(Source, "__init__", counted)
    return begun


SELECTIONS = [ClipSelection(), ClipSelection(2, 20, 3), ClipSelection(5, side=24)]


@pytest.mark.parametrize("selection", SELECTIONS)
def test_a_long_clip_is_the_same_as_a_short_one(
    clip: Path, selection: ClipSelection, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = open_video(clip, selection)
    monkeypatch.setattr(module, "HELD", 0)
    long = open_video(clip, selection)
    whole = np.asarray(short.frames)
    assert np.array_equal(long.frames, whole) and len(long.frames) == len(whole)
    assert long.frames.shape == whole.shape and long.size == short.size
    assert np.array_equal(long.times, short.times) and long.notes == short.notes
    for frames in (short.frames, long.frames):
        for part in (slice(2, 5), slice(-3, None), slice(0, None, 2), slice(4, 4)):
            assert np.array_equal(frames[part], whole[part])
            assert np.array_equal(frames[1:][part], whole[1:][part])
        assert np.array_equal(frames[[3, 0, 3, 1]], whole[[3, 0, 3, 1]])
        blocks = [*frames.chunks(2 * whole[0].nbytes)]
        assert {len(block) for block in blocks[:-1]} == {2}
        assert np.array_equal(np.concatenate(blocks), whole)


def test_rising_numbers_cost_one_decoding(clip: Path, decodings: list[int]) -> None:
    frames = open_video(clip, ClipSelection()).frames
    whole = np.asarray(frames)
    decodings.clear()
    for k in (0, 4, 3, 2, 9, COUNT - 1):
        assert np.array_equal(frames[k], whole[k])
    assert len(decodings) == 1
    assert np.array_equal(frames[1], whole[1])
    assert len(decodings) == 2


def test_frames_that_are_not_there(clip: Path, decodings: list[int]) -> None:
    video = open_video(clip, ClipSelection())
    with pytest.raises(IndexError):
        video.frames[COUNT]
    with pytest.raises(ValueError, match="step -1; decoding goes forward"):
        video.frames[::-1]
    clip.with_name("b.avi").write_bytes(clip.read_bytes())
    shorter = open_video(clip.with_name("b.avi"), ClipSelection())
    clip.with_name("b.avi").write_bytes(clip.read_bytes()[: clip.stat().st_size // 2])
    with pytest.raises(InputError, match=rf"b.avi: had {COUNT} frames and now has .*; it changed"):
        list(shorter.frames)


def test_frames_in_memory_are_not_copied() -> None:
    whole = np.zeros((4, 2, 3, 3), np.uint8)
    frames = held(whole)
    assert isinstance(frames[1:], Frames)
    assert np.shares_memory(np.asarray(frames[1:]), whole)


def test_a_recording_of_many_rows_without_a_clip_holds_no_picture_of_each(tmp_path):
    when, places = np.arange(5000) / 30, np.zeros((5000, 1, 2))
    tracemalloc.start()
    try:
        write_tracks_recording(tmp_path / "a.rrd", (when, places), {"rollout": (when, places)}, {})
        assert tracemalloc.get_traced_memory()[1] < 5e7
    finally:
        tracemalloc.stop()
    assert (tmp_path / "a.rrd").stat().st_size > 10_000
