"""Recordings of clips: what was observed, read and foretold, drawn over the pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vidphys.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from vidphys.data.frames import Frames
    from vidphys.data.video import ClipSelection, Video
    from vidphys.reading.forecasts import Forecast
    from vidphys.reading.pipeline import Reading
    from vidphys.reading.scores import Told
    from vidphys.reading.training import Perceived

ARRAYS = 2  # schema of arrays; 1 had no hash of them


def record_training(run: Path, perceived: Perceived, told: Told, selection: ClipSelection) -> None:
    """Write the recording of a scored clip into the run folder.

    Args:
        run: the folder.
        perceived: all clips.
        told: what was foretold of the shown one.
        selection: the frames that were used of it.
    """
    from vidphys.data.video import open_video
    from vidphys.reading.attention import attention_of, drawn_frames
    from vidphys.reading.clip_dynamics import FACTORED
    from viz.recording import write_overlay_recording

    clip, extent = perceived.clips[told.clip], perceived.reader.half_extent
    video = open_video(clip.file.path, selection)
    arrays: dict[str, Any] = {
        **_pictures(video, perceived.tracks[told.clip].positions[0], extent),
        "track": extent * clip.labels.positions[0].numpy(),
        **_rolled("rollout", told.forecasts[FACTORED], video, extent * clip.camera),
        "train_end": np.asarray(video.times[told.start - 1]),
    }
    features = clip.features[perceived.chosen.candidate.layer]
    drawn = drawn_frames(len(video.frames))
    arrays |= _attended(attention_of(perceived.reader.readout, features, drawn), video)
    _draw_clip(run, video.times, arrays)
    meta = {"cell": "clip", "clip": video.path.name}
    write_overlay_recording(arrays, meta, run / "recordings" / "clip.rrd")


def _draw_clip(run: Path, times: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
    """The scored clip and what was foretold of it, for the report."""
    from viz.figures import save_svg
    from viz.going_on import FORETOLD, going_on_figure

    rolled = {FORETOLD: (arrays["rollout_times"], arrays["rollout"])}
    path = run / "figures" / "clip.svg"
    path.parent.mkdir(exist_ok=True)
    save_svg(going_on_figure(times, arrays["track"], rolled), path)


def record_rollout(
    run: Path,
    video: Video,
    reading: Reading,
    changed: Forecast | None,
    extent: float,
    film: Path | None = None,
    law: str = "",
) -> None:
    """Write the recording of one clip that a pipeline read and rolled on.

    Args:
        run: the folder.
        video: the clip.
        reading: what the pipeline made of it.
        changed: its rollout under another law.
        extent: world units in half of the longer image side.
        film: the video file to draw it into as well.
        law: the other law in words.
    """
    from viz.recording import write_overlay_recording

    arrays: dict[str, Any] = {
        **_pictures(video, reading.tracks.positions[0], extent),
        **_rolled("rollout", reading.rollout, video, reading.camera),
        **_attended(reading.attention, video),
    }
    if changed is not None:
        arrays |= _rolled("changed", changed, video, reading.camera)
    meta = {"cell": "rollout", "clip": video.path.name, **({"law": law} if law else {})}
    write_overlay_recording(arrays, meta, run / "recordings" / "rollout.rrd")
    if film is not None:
        draw_film(arrays, film, law)


def write_tracks_recording(
    path: Path,
    track: tuple[np.ndarray, np.ndarray],
    rolled: dict[str, tuple[np.ndarray, np.ndarray]],
    meta: dict[str, str],
    pictures: tuple[Frames, np.ndarray] | None = None,
    film: Path | None = None,
) -> None:
    """Write the recording of tracks that were rolled on; none in three dimensions.

    Args:
        path: the ``.rrd``.
        track: times ``(t,)`` and places ``(t, n, d)``.
        rolled: the same by role, ``rollout`` and perhaps ``changed``.
        meta: what is shown, in words.
        pictures: frames and times of the clip that the tracks are of, in normalised image units.
        film: the video file to draw it into as well.
    """
    from vidphys.data.frames import blank
    from viz.recording import write_overlay_recording

    times, places = track
    if places.shape[-1] > 2:
        return
    shown = _plane(places)
    frames: Any
    if pictures is None:
        everything = [shown, *(_plane(there) for _, there in rolled.values())]
        extent = 1.1 * max(float(np.nanmax(np.abs(x), initial=1e-9)) for x in everything)
        frames, when = blank(len(times)), times
    else:
        (frames, when), extent = pictures, 1.0
        after = np.clip(np.searchsorted(times, when - 1e-6), 0, len(times) - 1)
        there = np.abs(times[after] - when) < 1e-6
        shown = np.where(there[:, None, None], shown[after], np.nan)
    arrays: dict[str, Any] = {
        "frames": frames,
        "frame_times": when,
        "readout": shown,
        "half_extent": np.asarray(extent),
    }
    for role, (at, path_there) in rolled.items():
        arrays |= {role: _plane(path_there), f"{role}_times": at}
    write_overlay_recording(arrays, meta, path)
    if film is not None:
        draw_film(arrays, film, meta.get("law", ""))


def followed_alone(times: np.ndarray, places: np.ndarray, frames: Frames) -> dict[str, Any]:
    """The arrays of a clip whose bodies were followed, and nothing foretold of them."""
    nothing = np.full((2, *places.shape[1:]), np.nan)
    return {
        "frames": frames,
        "frame_times": times,
        "readout": places,
        "rollout": nothing,
        "rollout_times": times[-2:],
        "half_extent": np.asarray(1.0),
    }


def told_law(coupling: float | None, law: Sequence[str], push: object = None) -> str:
    """What was changed in words, from what changed it: ``G = -1, friction times 0, a push``."""
    words = [] if coupling is None else [f"G = {coupling:g}".replace("-", "\u2212")]
    words += [" times ".join(x.split("=", 1)) for x in law]
    return ", ".join([*words, "a push"] if push else words)


def draw_film(
    arrays: Mapping[str, np.ndarray], path: Path, law: str = "", foretold: str = "forecast"
) -> None:
    """Draw the arrays of a recording over their frames, into a video file.

    Args:
        arrays: of the recording.
        path: the file.
        law: the changed law in words, where there is one.
        foretold: what the forecast is, in words.

    Raises:
        InputError: such a file cannot be written.
    """
    from viz.film import write_film

    try:
        write_film(arrays, path, law or "another law", foretold)
    except ValueError as error:
        raise InputError(f"--video {path}: {error}") from error


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write an ``.npz`` that says its schema, whole or not at all."""
    from registry.seal import sealed_arrays
    from vidphys.runs.atomic import write_with

    def save(partial: Path) -> None:
        with partial.open("wb") as file:
            whole = sealed_arrays({"schema_version": np.array(ARRAYS), **arrays})
            np.savez(file, allow_pickle=False, **whole)

    write_with(path, save)


def _plane(places: np.ndarray) -> np.ndarray:
    """Places of one dimension drawn on the horizontal axis."""
    if places.shape[-1] == 2:
        return places
    return np.concatenate([places, np.zeros_like(places)], -1)


def _pictures(video: Video, read: Tensor, extent: float) -> dict[str, Any]:
    return {
        "frames": video.frames,
        "frame_times": video.times,
        "readout": read.numpy(),
        "half_extent": np.asarray(extent),
    }


def _attended(shares: Tensor | None, video: Video) -> dict[str, np.ndarray]:
    """What the readout attends to, where it does."""
    from vidphys.reading.attention import drawn_frames

    if shares is None:
        return {}
    drawn = drawn_frames(len(video.frames)).numpy()
    return {"attention": shares.numpy(), "attention_times": video.times[drawn]}


def _rolled(name: str, found: Forecast, video: Video, camera: Tensor) -> dict[str, np.ndarray]:
    """A rollout as the camera sees it, which after the clip stays where it was."""
    drift, times = camera.numpy(), found.times.numpy()
    seen = np.stack([np.interp(times, video.times, drift[:, axis]) for axis in range(2)], -1)
    return {name: found.positions.numpy() + seen[:, None], f"{name}_times": times}
