"""Frames that come unevenly: told, and tracks read off at even times."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from binders import Tracks
from dynamics import Parameters
from tests.shared.small_clips import cells, pictures, swing  # noqa: F401
from tests.shared.uneven import write_uneven
from tests.vidphys.cli.test_train_verb import coarse
from vidphys.cli import main
from vidphys.data.evenness import evenly, jitter
from vidphys.data.video import ClipSelection, open_video
from vidphys.reading.clip_dynamics import Followed, sample
from vidphys.reading.forecasts import naive_forecasts

EVEN = np.arange(60) / 30.0


def uneven(seed: int = 0) -> np.ndarray:
    late = np.random.default_rng(seed).uniform(-0.3, 0.3, 60) / 30
    return EVEN + late


def fall(times: np.ndarray) -> Tracks:
    t = torch.from_numpy(times)
    place = torch.stack([0.3 * t, 1 - 0.5 * t**2], -1)[None, :, None]
    return Tracks(place, torch.ones(1, len(t), 1).double(), t)


def test_jitter_is_told_in_intervals_and_rounding_is_none() -> None:
    assert jitter(EVEN) < 1e-9
    assert jitter(np.round(EVEN, 3)) == 0.0
    assert jitter(np.round(np.arange(60) / 60.0, 3)) == 0.0
    assert jitter(uneven()) > 0.2
    assert jitter(np.delete(EVEN, 30)) > 0.2


def test_an_even_track_stays_what_it_is() -> None:
    track = fall(EVEN)
    assert torch.equal(evenly(track, 40).positions, track.positions[:, :40])


def test_an_uneven_track_is_read_off_at_even_times_that_end_where_it_ends() -> None:
    track = evenly(fall(uneven()), 40)
    steps = np.diff(track.times.numpy())
    np.testing.assert_allclose(steps, steps[0])
    assert float(track.times[-1]) == pytest.approx(uneven()[39])
    torch.testing.assert_close(track.positions, fall(track.times.numpy()).positions)
    assert track.confidence.min() > 0.999


def test_where_frames_are_missing_nothing_is_sure() -> None:
    whole = fall(EVEN)
    kept = torch.from_numpy(np.delete(np.arange(60), [30, 31]))
    track = Tracks(whole.positions[:, kept], whole.confidence[:, kept], whole.times[kept])
    even = evenly(track, 58)
    assert len(even.times) == 60
    assert even.confidence[0, :, 0].numpy().nonzero()[0].tolist() == [*range(30), *range(32, 60)]


def test_dynamics_are_fitted_to_what_came_evenly() -> None:
    from vidphys.data.charts import Plane

    law = Parameters(torch.ones(1), torch.ones(1, 1))
    samples = sample([Followed(fall(uneven()), law)], [60], Plane())
    second = samples.tracks.positions.diff(n=2, dim=1) / samples.interval**2
    torch.testing.assert_close(
        second[..., 1], torch.full_like(second[..., 1], -1.0), atol=1e-4, rtol=0
    )
    by_index = fall(uneven()).positions[:, ::3].diff(n=2, dim=1) / 0.1**2
    assert (by_index[..., 1] + 1).abs().max() > 0.5  # what striding by number would give


def test_the_last_speed_is_that_of_time_not_of_frames() -> None:
    times = uneven()
    t = torch.from_numpy(times)
    place = torch.stack([0.3 * t, -0.2 * t], -1)[None, :, None]
    track = Tracks(place, torch.ones(1, 60, 1).double(), t)
    found = naive_forecasts(track, 40)["constant-velocity"]
    torch.testing.assert_close(found.positions, place[0, 39:])


@pytest.mark.usefixtures("cells")
def test_training_says_so_and_keeps_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    coarse(monkeypatch)
    times = np.cumsum(np.tile([30, 50], 45)) / 1000 + 0.5
    places = np.stack([swing(1, 2 * np.pi * at / 1.2)[0] for at in times])
    clip = tmp_path / "clip.mkv"
    write_uneven(clip, pictures(places), times)
    video = open_video(clip, ClipSelection())
    np.testing.assert_allclose(np.diff(video.times), np.diff(times), atol=1e-3)
    rows = "\n".join(f"{u},{v}" for u, v in places[:, 0])
    clip.with_suffix(".csv").write_text(f"u1,v1\n{rows}\n")
    quick = ["--encoder", "cells", "--steps", "8", "--head-steps", "2", "--readout", "attention"]
    where = ["--store", str(tmp_path / "f"), "--out", str(tmp_path / "run")]
    assert main(["train", str(clip), *quick, *where]) == 0
    said = capsys.readouterr().err
    assert "labels: clip.csv (1 body)\n" in said
    assert f"{clip}: note: frames come unevenly, up to 0.1" in said
    kept = json.loads((tmp_path / "run" / "run.json").read_text())
    assert kept["labels"] == "labels: clip.csv (1 body)"
    (about,) = kept["clips"]
    assert about["first_seconds"] == pytest.approx(video.times[0]) and about["first_frame"] == 0
    assert about["decoder"].startswith("opencv-python-headless ")
    assert any("unevenly" in note for note in about["notes"])
    clip.with_suffix(".csv").unlink()
    assert main(["train", str(clip), *quick, *where, "--overwrite"]) == 0
    assert "labels: none, following motion (1 body)" in capsys.readouterr().err
