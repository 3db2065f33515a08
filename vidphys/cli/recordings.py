"""Recordings of clips: what was observed, read and foretold, drawn over the pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

if TYPE_CHECKING:
    from vidphys.data.video import ClipSelection, Video
    from vidphys.reading.forecasts import Forecast
    from vidphys.reading.pipeline import Reading
    from vidphys.reading.scores import Told
    from vidphys.reading.training import Perceived


def record_training(run: Path, perceived: Perceived, told: Told, selection: ClipSelection) -> None:
    """Write the recording of a scored clip into the run folder.

    Args:
        run: the folder.
        perceived: all clips.
        told: what was foretold of the shown one.
        selection: the frames that were used of it.
    """
    from vidphys.data.video import read_video
    from vidphys.reading.clip_dynamics import FACTORED
    from viz.recording import write_overlay_recording

    clip, extent = perceived.clips[told.clip], perceived.reader.half_extent
    video = read_video(clip.file.path, selection)
    arrays = {
        **_pictures(video, perceived.tracks[told.clip].positions[0], extent),
        "track": extent * clip.labels.positions[0].numpy(),
        **_rolled("rollout", told.forecasts[FACTORED], video, extent * clip.camera),
        "train_end": np.asarray(video.times[told.start - 1]),
    }
    meta = {"cell": "clip", "clip": video.path.name}
    write_overlay_recording(arrays, meta, run / "recordings" / "clip.rrd")


def record_rollout(
    run: Path, video: Video, reading: Reading, changed: Forecast | None, extent: float
) -> None:
    """Write the recording of one clip that a pipeline read and rolled on.

    Args:
        run: the folder.
        video: the clip.
        reading: what the pipeline made of it.
        changed: its rollout under another law.
        extent: world units in half of the longer image side.
    """
    from viz.recording import write_overlay_recording

    arrays = {
        **_pictures(video, reading.tracks.positions[0], extent),
        **_rolled("rollout", reading.rollout, video, reading.camera),
    }
    if changed is not None:
        arrays |= _rolled("changed", changed, video, reading.camera)
    meta = {"cell": "rollout", "clip": video.path.name}
    write_overlay_recording(arrays, meta, run / "recordings" / "rollout.rrd")


def _pictures(video: Video, read: Tensor, extent: float) -> dict[str, np.ndarray]:
    return {
        "frames": video.frames,
        "frame_times": video.times,
        "readout": read.numpy(),
        "half_extent": np.asarray(extent),
    }


def _rolled(name: str, found: Forecast, video: Video, camera: Tensor) -> dict[str, np.ndarray]:
    """A rollout as the camera sees it, which after the clip stays where it was."""
    drift, times = camera.numpy(), found.times.numpy()
    seen = np.stack([np.interp(times, video.times, drift[:, axis]) for axis in range(2)], -1)
    return {name: found.positions.numpy() + seen[:, None], f"{name}_times": times}
