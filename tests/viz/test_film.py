"""A film shows what is drawn over each frame, and goes on after the clip."""

import resource
import sys

import cv2
import numpy as np
import pytest

from viz import film as module
from viz.film import write_film
from viz.recording import COLOURS


def clip(frames=12, interval=0.1):
    times = interval * np.arange(frames)
    path = np.stack([np.linspace(-0.8, 0.0, frames), np.zeros(frames)], -1)[:, None]
    later = times[-1] + interval * np.arange(9)
    onwards = np.stack([np.linspace(0.0, 0.6, 9), np.zeros(9)], -1)[:, None]
    return {
        "frames": np.full((frames, 240, 400, 3), 60, np.uint8),
        "frame_times": times,
        "readout": path,
        "rollout": onwards,
        "rollout_times": later,
        "changed": onwards * [1.0, 0.0] + [0.0, 0.3],
        "changed_times": later,
        "half_extent": np.asarray(1.0),
    }


def read(path):
    film = cv2.VideoCapture(str(path))
    rate, frames = film.get(cv2.CAP_PROP_FPS), []
    while (got := film.read())[0]:
        frames.append(cv2.cvtColor(got[1], cv2.COLOR_BGR2RGB))
    return rate, np.stack(frames).astype(float)


def near(frame, role, at):
    """How near the colour of a role comes to what is drawn about a place (x, y)."""
    x, y = at
    patch = frame[y - 6 : y + 7, x - 6 : x + 7].reshape(-1, 3)
    return np.abs(patch - COLOURS[role]).mean(-1).min()


def test_a_film_shows_track_forecast_and_changed_law_where_they_are(tmp_path):
    video = clip()
    write_film(video, tmp_path / "films" / "clip.mp4")
    rate, frames = read(tmp_path / "films" / "clip.mp4")
    assert rate == pytest.approx(10.0) and frames.shape == (20, 240, 400, 3)
    assert near(frames[3], "readout", (200 + round(200 * video["readout"][3, 0, 0]), 120)) < 40
    assert near(frames[-1], "rollout", (320, 120)) < 40
    assert near(frames[-1], "changed", (320, 60)) < 40
    assert near(frames[3], "changed", (320, 60)) > 60  # not yet
    assert frames[3, -20:].mean() == pytest.approx(60, abs=5)
    assert frames[-1, -20:].mean() == pytest.approx(21, abs=5)  # dimmed


def test_a_small_clip_is_enlarged_and_lost_bodies_leave_no_mark(tmp_path):
    video = clip()
    video["frames"] = video["frames"][:, :61, :101]
    video["readout"] = np.full_like(video["readout"], np.nan)
    write_film(video, tmp_path / "clip.mp4")
    _, frames = read(tmp_path / "clip.mp4")
    assert max(frames.shape[1:3]) >= 320
    assert frames[5, 100:, :].std() < 8
    with pytest.raises(ValueError, match="missing rollout"):
        write_film({k: v for k, v in video.items() if k != "rollout"}, tmp_path / "no.mp4")


def test_the_legend_says_what_is_foretold(tmp_path, monkeypatch):
    told = set()
    monkeypatch.setattr(cv2, "putText", lambda *given: told.add(given[1]))
    write_film(clip(), tmp_path / "clip.mp4", "no drag", "it stays where it was")
    assert told == {"track", "it stays where it was", "no drag"}


@pytest.fixture
def short_of_room(monkeypatch):
    """A disk on which no file grows beyond some bytes, and no compiled module is cut short."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("short_of_room")
def test_a_full_disk_leaves_the_film_of_before(tmp_path):
    (tmp_path / "clip.mp4").write_bytes(b"of before")
    with pytest.raises(OSError, match="not written whole"):
        write_film(clip(), tmp_path / "clip.mp4")
    assert [p.name for p in tmp_path.iterdir()] == ["clip.mp4"]
    assert (tmp_path / "clip.mp4").read_bytes() == b"of before"


def test_a_film_that_is_broken_off_leaves_the_one_of_before(tmp_path, monkeypatch):
    (tmp_path / "clip.mp4").write_bytes(b"of before")
    left = iter(range(5))
    monkeypatch.setattr(module, "_draw", lambda *_: next(left))
    with pytest.raises((StopIteration, RuntimeError)):
        write_film(clip(), tmp_path / "clip.mp4")
    assert (tmp_path / "clip.mp4").read_bytes() == b"of before"
    assert [p.name for p in tmp_path.iterdir()] == ["clip.mp4"]
