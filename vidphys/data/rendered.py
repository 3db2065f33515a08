"""Rendered clips as a folder that a user can look at and train on.

::

    OUT/run.json                the settings and versions; the same command goes on
    OUT/clips/00000.avi         FFV1: every pixel is kept, and players know it
    OUT/clips/00000.csv         times, and true positions in world units
    OUT/truth/00000.parquet     all of the truth: see :func:`truth_of`
    OUT/dataset.json            written last; see :mod:`vidphys.data.dataset`
"""

from __future__ import annotations

import errno
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from renderers import PALETTE, WORLDS, Camera
from vidphys.data.clips import Clips, render_clips
from vidphys.data.formats.opencv import opencv
from vidphys.data.labels import write_labels
from vidphys.data.sets.folder import MANIFEST, SCHEMA_VERSION
from vidphys.errors import InputError
from vidphys.progress import Progress
from vidphys.runs.atomic import sha256, write_json, write_with
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import write_table
from vidphys.scenes import SCENES, Scene

LOOKS = {"channels": "channel", "rgb": "rgb", "anonymous": "anonymous"}
MOST = {"channels": 3, "rgb": len(PALETTE)}  # bodies, each of another colour
AT_ONCE = 16  # clips that are simulated side by side and come from one random stream
CODEC = "FFV1"


@dataclass(frozen=True)
class RenderSettings:
    """What is drawn.

    Args:
        scene: of :data:`vidphys.scenes.SCENES`.
        world: of :data:`LOOKS`: a channel for each body (up to three: red, green and blue),
            coloured disks that hide one another, or bodies that look alike.
        clips, frames: how many, and how long.
        stride: steps of the simulation from a frame to the next.
        image: pixels on a side; even, because the codec rounds odd ones.
        seed: of the episodes.
    """

    scene: str
    world: str
    clips: int
    frames: int
    stride: int
    image: int
    seed: int

    def __post_init__(self) -> None:
        for name, value, least in (
            ("clips", self.clips, 1),
            ("frames", self.frames, 1),
            ("stride", self.stride, 1),
            ("image", self.image, 2),
        ):
            if value < least:
                raise InputError(f"`{name}` {value}: must be at least {least}")
        if self.image % 2:
            raise InputError(f"`image` {self.image}: must be even; use {self.image + 1}")
        scene = SCENES[self.scene]()
        start, _ = scene.sample(1, torch.Generator().manual_seed(0))
        space = scene.place(start.q).shape[-1]
        if space != 2:
            raise InputError(
                f"`scene` {self.scene}: only bodies in a plane can be drawn, and its have {space} "
                "coordinate(s); a `place` of its own says where they are in a picture"
            )
        if scene.bodies > MOST.get(self.world, scene.bodies):
            raise InputError(
                f"`world` {self.world}: has {MOST[self.world]} colours, and the scene {self.scene} "
                f"{scene.bodies} bodies; use the world anonymous"
            )


def render_folder(
    run: RunFolder, settings: RenderSettings, progress: Progress | None = None
) -> Path:
    """Write the clips that are not there yet, then the manifest; returns its path.

    A clip depends on the settings and its own number only.

    Args:
        run: an open folder.
        settings: see :class:`RenderSettings`.
        progress: called as ``(clips done, clips, 0.0)``.

    Raises:
        InputError: a scene that hardly ever keeps its bodies in the frame.
    """
    scene = SCENES[settings.scene]()
    entries: list[dict[str, Any]] = []
    for first in range(0, settings.clips, AT_ONCE):
        drawn = _draw(scene, settings, first // AT_ONCE)
        for k in range(min(AT_ONCE, settings.clips - first)):
            entries.append(_write(run.path, first + k, drawn, k, scene))
            if progress is not None:
                progress(first + k + 1, settings.clips, 0.0)
    manifest = {
        "schema_version": SCHEMA_VERSION,
        "scene": scene.name,
        "settings": scene.settings,
        "world": settings.world,
        "half_extent": drawn.world.camera.half_extent,
        "interval_seconds": drawn.interval,
        "identical": settings.world == "anonymous",
        "conserving": scene.conserves,
        "derivatives_without": scene.derivatives_without,
        "clips": entries,
    }
    write_json(run.path / MANIFEST, manifest)
    return run.path / MANIFEST


def _draw(scene: Scene, settings: RenderSettings, block: int) -> Clips:
    camera = Camera(scene.half_extent, settings.image, settings.image)
    world = WORLDS[LOOKS[settings.world]](camera=camera)
    return render_clips(
        scene, world, AT_ONCE, settings.frames, settings.stride, settings.seed, f"render-{block}"
    )


def _write(folder: Path, number: int, drawn: Clips, k: int, scene: Scene) -> dict[str, Any]:
    """Write one clip with its labels and its truth, unless they are there; returns its entry."""
    video = folder / "clips" / f"{number:05d}.avi"
    table = video.with_suffix(".csv")
    positions = scene.place(drawn.states.q[k]).numpy()
    if not video.exists():
        pictures = _pictures(drawn.frames[k].permute(0, 2, 3, 1).numpy())
        write_with(video, lambda partial: write_video(partial, pictures, 1 / drawn.interval))
    if not table.exists():
        write_with(table, lambda partial: write_labels(partial, drawn.times.numpy(), positions))
    truth = folder / "truth" / f"{number:05d}.parquet"
    if not truth.exists():
        write_table(truth, truth_of(drawn, k, scene))
    return {
        "file": f"clips/{video.name}",
        "sha256": sha256(video),
        "labels_sha256": sha256(table),
        "truth": f"truth/{truth.name}",
        "coupling": float(drawn.params.coupling[k]),
        "mass": drawn.params.mass[k].tolist(),
    }


def truth_of(clips: Clips, k: int, scene: Scene) -> pa.Table:
    """All that is known of one clip, a row for each frame, in world units and seconds.

    Columns: ``time``; of each body 1, 2, ... where it is drawn ``x1, y1``, momentum ``px1, py1``,
    their derivatives ``vx1, vy1`` and ``fx1, fy1`` (see :meth:`vidphys.scenes.Scene.derivatives`),
    its mass ``m1`` and, where the law has charges, its charge ``z1``; ``coupling``, and the law's
    further strengths by name. A body of one coordinate has that as ``q1``, its momentum ``p1`` and
    their derivatives ``v1`` and ``f1``.
    """
    states, frames = clips.states[k], len(clips.times)
    params = clips.params[[k] * frames].map(torch.Tensor.double)
    slope, places = scene.derivatives(states, params), scene.place(states.q)
    told = {"p": states.p, "v": slope.q, "f": slope.p}
    axes = ("x", "y") if scene.space == 2 else ("",)
    columns = {"time": clips.times}
    for body in range(scene.bodies):
        for axis, letter in enumerate("xy"):
            columns[f"{letter}{body + 1}"] = places[:, body, axis]
        if scene.space == 1:
            columns[f"q{body + 1}"] = states.q[:, body, 0]
        for name, values in told.items():
            for axis, letter in enumerate(axes):
                columns[f"{name}{letter}{body + 1}"] = values[:, body, axis]
        columns[f"m{body + 1}"] = params.mass[:, body]
        if params.charge is not None:
            columns[f"z{body + 1}"] = params.charge[:, body]
    columns |= {"coupling": params.coupling, **params.scalars}
    return pa.table({name: values.detach().double().numpy() for name, values in columns.items()})


def _pictures(frames: np.ndarray) -> np.ndarray:
    """``(t, H, W, c)`` as RGB: one channel is grey, two or three are red, green and blue."""
    channels = frames.shape[-1]
    if channels == 1:
        return frames.repeat(3, -1)
    return np.pad(frames, [(0, 0)] * 3 + [(0, 3 - channels)])


def write_video(path: Path, frames: np.ndarray, rate: float) -> None:
    """Write RGB ``frames (t, H, W, 3)``, bytes, as a video that loses no pixel.

    Raises:
        InputError: OpenCV was built without the codec.
        OSError: not all of it was written, of which the codec says nothing.
    """
    cv2 = opencv()
    size = frames.shape[2], frames.shape[1]
    fourcc = cv2.VideoWriter.fourcc(*CODEC)
    # the container is told by the name, which a file that is not finished does not have yet
    target = path.with_name(f"{path.name}.avi")
    writer = cv2.VideoWriter(str(target), cv2.CAP_FFMPEG, fourcc, rate, size)
    if not writer.isOpened():
        raise InputError(f"render: this OpenCV has no {CODEC} writer; use its wheel from the index")
    try:
        for frame in frames:
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        writer.release()
        if not _holds(cv2, target, frames):
            raise OSError(errno.ENOSPC, "not written whole, the disk may be full", str(path))
        target.replace(path)
    finally:
        writer.release()
        target.unlink(missing_ok=True)


def _holds(cv2: Any, path: Path, frames: np.ndarray) -> bool:
    """Whether a video that was just written has these frames and no other."""
    reader = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        for frame in frames:
            _, found = reader.read()
            if found is None or not np.array_equal(cv2.cvtColor(found, cv2.COLOR_BGR2RGB), frame):
                return False
        return not reader.read()[0]
    finally:
        reader.release()
