"""From a clip to a perceived track: the stages, and the run over a real recording."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from binders.motion import MotionSettings, MotionTracks
from binders.tracks import Tracks
from encoders.features import FeatureMap
from encoders.frozen import HieraSettings, load_hiera
from encoders.identity import EncoderIdentity
from encoders.known_weights import KNOWN
from encoders.store import FeatureStore
from vidphys.errors import InputError
from vidphys.experiments.real_clip import (
    PerceivedClip,
    RealClipSettings,
    perceive_clip,
    split_frames,
)
from vidphys.extraction import extract
from vidphys.train import FitSettings
from vidphys.video import ClipSelection, Video, read_video

FRAMES, SIZE = 100, 64


class Cells:
    """An encoder that needs no weights: mean colour of 8 x 8 cells, and how often it ran."""

    identity = EncoderIdentity("cells", 1, "0" * 64, "none", "8", SIZE, "float32")

    def __init__(self) -> None:
        self.frames = 0

    def __call__(
        self,
        frames: Tensor,
        times: Tensor,
        progress: Callable[[int, int], None] | None = None,
    ) -> FeatureMap:
        assert frames.dtype == torch.uint8  # a long clip never exists in floats as a whole
        self.frames += frames.shape[1]
        values = functional.avg_pool2d(frames[0].float() / 255, 8)[None]
        if progress is not None:
            progress(frames.shape[1], frames.shape[1])
        return FeatureMap(values, (8.0, 8.0), times)


def ball(t: np.ndarray) -> np.ndarray:
    """Pixels (x, y), in view throughout."""
    return np.stack([32 + 20 * np.sin(0.37 * t), 32 + 14 * np.cos(0.23 * t)], 1)


@pytest.fixture(scope="module")
def video() -> Video:
    y, x = np.mgrid[:SIZE, :SIZE]
    noise = np.random.default_rng(0)
    frames = np.empty((FRAMES, SIZE, SIZE, 3), np.uint8)
    for frame, (cx, cy) in zip(frames, ball(np.arange(FRAMES)), strict=True):
        body = np.clip(6.5 - np.hypot(x - cx, y - cy), 0, 1)[..., None]
        image = 110 * (1 - body) + np.array([220, 30, 40]) * body
        frame[:] = image + noise.normal(scale=1, size=frame.shape)
    times = np.arange(FRAMES) / 30
    return Video(Path("ball.avi"), "a" * 64, frames, times, np.arange(FRAMES), ())


@pytest.fixture(scope="module")
def perceived(video: Video, tmp_path_factory: pytest.TempPathFactory) -> PerceivedClip:
    store = FeatureStore(tmp_path_factory.mktemp("store"))
    settings = RealClipSettings(fit=FitSettings(300, 16, 1e-2), cells=1)
    return perceive_clip(video, Cells(), store, settings)


def test_all_frames_are_perceived_and_the_readout_beats_its_controls(
    perceived: PerceivedClip,
) -> None:
    score = {s.name: s for s in perceived.scores}
    assert score["attention"].pixels < 2.0
    assert score["attention"].pixels < score["pooled"].pixels / 3
    assert score["attention"].pixels < score["constant"].pixels / 5
    assert score["constant"].pixels == pytest.approx(score["constant"].normalised * SIZE / 2)
    track = perceived.track
    assert track.positions.shape == (1, FRAMES, 1, 2)
    assert torch.equal(track.times, torch.from_numpy(perceived.video.times))
    truth = (ball(np.arange(FRAMES)) + 0.5 - SIZE / 2) / (SIZE / 2) * [1, -1]
    error = track.positions[0, :, 0].numpy() - truth
    assert np.sqrt((error**2).sum(1).mean()) * SIZE / 2 < 2.0


def test_scores_use_frames_that_no_readout_saw(perceived: PerceivedClip) -> None:
    split = perceived.split
    assert split.end == 60
    seen = torch.cat([split.train, split.held_out]).sort().values
    assert seen.tolist() == list(range(60))
    assert split.scored.tolist() == list(range(60, FRAMES))
    assert len(split.held_out) == pytest.approx(60 / 5, abs=8)
    constant = perceived.hand.tracks.positions[0, split.train].mean(0)
    rest = perceived.hand.tracks.positions[0, 60:]
    expected = float((rest - constant).square().sum(-1).mean().sqrt())
    (score,) = [s for s in perceived.scores if s.name == "constant"]
    weight = perceived.hand.tracks.confidence[0, 60:]
    assert torch.allclose(weight, torch.ones_like(weight), atol=0.3)
    assert score.normalised == pytest.approx(expected, rel=0.05)


def test_steady_track_is_without_the_camera(perceived: PerceivedClip) -> None:
    camera = torch.randn(FRAMES, 2)
    moved = PerceivedClip(
        **{
            **perceived.__dict__,
            "hand": MotionTracks(perceived.hand.tracks, camera),
        }
    )
    back = moved.steady_track.positions[0, :, 0] + camera
    torch.testing.assert_close(back, perceived.track.positions[0, :, 0])
    assert isinstance(moved.steady_track, Tracks)


def test_extraction_is_cached(video: Video, tmp_path: Path) -> None:
    encoder, store = Cells(), FeatureStore(tmp_path)
    calls: list[tuple[int, int]] = []
    first = extract(
        video, encoder, store, "float32", lambda done, total, _: calls.append((done, total))
    )
    assert encoder.frames == FRAMES and calls[-1] == (FRAMES, FRAMES) and not first.cached
    again = extract(video, encoder, store, "float32")
    assert again.cached and again.key == first.key and encoder.frames == FRAMES
    whole = torch.from_numpy(video.frames).permute(0, 3, 1, 2)[None]
    expected = encoder(whole, torch.from_numpy(video.times))
    assert torch.equal(again.features.values, expected.values)
    assert torch.equal(again.features.times, expected.times)


@pytest.mark.parametrize(("frames", "share"), [(100, 0.2), (100, 1.0), (100, -1.0), (41, 0.99)])
def test_split_needs_both_parts(frames: int, share: float) -> None:
    with pytest.raises(InputError, match="frames to train on and"):
        split_frames(frames, share)


def test_bad_clips(video: Video, tmp_path: Path) -> None:
    def cut(frames: np.ndarray) -> Video:
        count = len(frames)
        return Video(Path("c.avi"), "b" * 64, frames, video.times[:count], np.arange(count), ())

    store = FeatureStore(tmp_path)
    with pytest.raises(InputError, match="momentum needs at least 80 frames"):
        perceive_clip(cut(video.frames[:1]), Cells(), store, RealClipSettings())
    frozen = np.repeat(video.frames[:1], FRAMES, 0)
    with pytest.raises(InputError, match=r"c\.avi: .*no frame shows 1 moving bodies"):
        perceive_clip(cut(frozen), Cells(), store, RealClipSettings())
    assert not list(tmp_path.iterdir())


def test_real_pendulum(tmp_path: Path) -> None:
    clips, where = os.environ.get("VIDPHYS_CLIPS"), os.environ.get("VIDPHYS_WEIGHTS")
    if clips is None or not (Path(clips) / "pendulum_string.mp4").is_file():
        pytest.skip("VIDPHYS_CLIPS does not name a folder with pendulum_string.mp4")
    if where is None or not (Path(where) / KNOWN["hiera"].file).is_file():
        pytest.skip(f"VIDPHYS_WEIGHTS does not name a folder with {KNOWN['hiera'].file}")
    video = read_video(Path(clips) / "pendulum_string.mp4", ClipSelection(side=320))
    encoder = load_hiera(HieraSettings(resolution=128), Path(where))
    settings = RealClipSettings(
        motion=MotionSettings(), fit=FitSettings(steps=600, batch=16, learning_rate=3e-3), cells=2
    )
    perceived = perceive_clip(video, encoder, FeatureStore(tmp_path), settings)
    score = {s.name: s.normalised for s in perceived.scores}
    assert (perceived.hand.tracks.confidence > 0.3).all()
    assert score["attention"] < 0.02
    assert score["attention"] < score["pooled"]
    assert score["attention"] < score["constant"] / 10
