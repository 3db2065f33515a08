"""Recordings of a ladder's cells and of clips: arrays in, one ``.rrd`` out, its layout embedded.

A recording holds siblings on one timeline (``sim_time`` in seconds; the same instants counted in
``step``): ``world/truth``, ``world/prediction``, ``world/counterfactual_truth`` and
``world/counterfactual`` beside ``energy/*`` and ``energy_error/*``. World positions are stored as
they are, y upwards; a static transform turns them for rerun's 2-D views, whose y points down.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from viz.layout import overlay_layout, showcase_layout
from viz.overlay import BODY_COLOURS, world_to_pixel
from viz.showcase import (
    ROLES,
    Arrays,
    check_showcase,
    check_video,
    context,
    half_extent,
    laws_of,
    scalar,
    zoom_extent,
)
from viz.story import ROLLED
from viz.story import marks as happenings
from viz.tape import COLOURS, Tape

VIDEO_ARRAYS = {  # role -> (positions, their times), where they are not those of the frames
    "observed": ("track", "frame_times"),
    "readout": ("readout", "frame_times"),
    "rollout": ("rollout", "rollout_times"),
    "changed": ("changed", "changed_times"),
}


def write_recording(showcase: Arrays, meta: Mapping[str, str], path: Path) -> None:
    """Write the recording of one ladder cell.

    Args:
        showcase: ``times (T,)`` in seconds, 0 at the moment when the law may change; ``truth``,
            ``prediction``, ``counterfactual_truth``, ``counterfactual`` ``(T, N, 2)`` in world
            units; ``energy_*`` of each ``(T,)``; ``half_extent`` in world units; optional ``dt``,
            seconds of one simulation step (else the spacing of ``times``), ``long_times (L,)`` with
            ``energy_long (L,)``, and ``frames (F, H, W, 3)`` uint8 with ``frame_times (F,)`` and
            ``track (F, N, 2)``, and with them ``attention (F, N, h, w)``. Non-finite instants are
            left blank.
        meta: what is shown, in words; ``cell`` becomes the recording's name.
        path: the ``.rrd`` to write, replaced as a whole or not at all.

    Raises:
        ValueError: an array is missing or has the wrong shape.
    """
    check_showcase(showcase)
    times = np.asarray(showcase["times"], np.float64)
    extent, zoom = half_extent(showcase), zoom_extent(showcase)
    dt = scalar(showcase, "dt") if "dt" in showcase else float(np.median(np.diff(times)))
    names = laws_of(meta)
    tape = Tape(meta, dt, names, {f"world/{role}": names[role] for role in ROLES})
    tape.turn_upright("world")
    since, past = context(showcase)
    if len(since):  # it disappears with the first instant of the rollout
        since = np.append(since, times[times > 0][0])
        past = np.concatenate([past, np.full_like(past[:1], np.nan)])
        tape.bodies("world/context", since, past, [COLOURS["context"]], 0.035 * zoom)
    for role in ROLES:
        radius = zoom * (0.035 if role.endswith("truth") else 0.02)
        tape.bodies(f"world/{role}", times, showcase[role], [COLOURS[role]], radius)
        tape.energy(role, times, showcase[f"energy_{role}"])
    if "energy_long" in showcase:
        tape.energy("long", np.asarray(showcase["long_times"]), showcase["energy_long"])
    if "frames" in showcase:
        stamps, (height, width) = showcase["frame_times"], showcase["frames"].shape[1:3]
        factor = tape.pictures("camera/image", stamps, showcase["frames"])
        if "attention" in showcase:
            until, size = np.append(stamps, times[times > 0][0]), (height / factor, width / factor)
            tape.attention("camera/attention", until, showcase["attention"], size)
        track = world_to_pixel(showcase["track"], (height, width), extent) / factor
        radius = 0.012 * max(height, width) / factor
        tape.bodies("camera/track", stamps, track, BODY_COLOURS, radius)
    marks = {float(since[0]): "observed", 0.0: ROLLED} if len(since) else {0.0: ROLLED}
    marks |= happenings(showcase)
    if "energy_long" in showcase and showcase["long_times"][-1] > times[-1]:
        marks[float(times[-1])] = "long rollout: energy only"
    tape.phases(dict(sorted(marks.items())))
    tape.save(path, showcase_layout(showcase))


def write_overlay_recording(video: Arrays, meta: Mapping[str, str], path: Path) -> None:
    """Write the recording of a real clip with what was observed, read and predicted drawn over it.

    Args:
        video: ``frames (F, H, W, 3)`` uint8; ``frame_times (F,)`` in seconds; ``readout
            (F, N, 2)``, what the readout predicts; ``rollout (R, N, 2)`` at ``rollout_times (R,)``,
            which may end after the clip. Positions in world units (y upwards, origin at the image
            centre) with ``half_extent``, the world length of half of the longer image side.
            Optional ``track (F, N, 2)``, what was observed; ``attention (A, N, h, w)`` at
            ``attention_times (A,)``, how much each cell of a grid over the picture counted for a
            body; ``changed`` and ``changed_times``, a rollout under another law; ``train_end``,
            seconds.
        meta: what is shown, in words; ``cell`` becomes the recording's name, ``law`` that of
            ``changed``, and ``foretold`` that of ``rollout``.
        path: the ``.rrd`` to write, replaced as a whole or not at all.

    Raises:
        ValueError: an array is missing or has the wrong shape.
    """
    check_video(video)
    stamps = np.asarray(video["frame_times"], np.float64)
    interval = float(np.median(np.diff(stamps)))
    height, width = video["frames"].shape[1:3]
    held = meta.get("foretold") or "the law that held"
    names = {"rollout": held, "changed": other_law(meta)}
    shown = {f"video/{role}": names[role] for role in names if role in video}
    tape = Tape(meta, interval, names, shown)
    factor = tape.pictures("video/image", stamps, video["frames"])
    radius = 0.014 * max(height, width) / factor
    after = np.array([stamps[-1] + interval])
    if "attention" in video:
        until = np.append(np.asarray(video["attention_times"], np.float64), after)
        stored = height / factor, width / factor
        tape.attention("video/attention", until, video["attention"], stored)
    for role, (key, times) in VIDEO_ARRAYS.items():
        if key not in video:
            continue
        when, positions = np.asarray(video[times], np.float64), video[key]
        if times == "frame_times":  # nothing is seen after the clip
            when = np.append(when, after)
            positions = np.concatenate([positions, np.full_like(positions[:1], np.nan)])
        pixels = world_to_pixel(positions, (height, width), half_extent(video)) / factor
        size = radius if role == "observed" else 0.6 * radius
        tape.bodies(f"video/{role}", when, pixels, [COLOURS[role]], size)
        for axis, name in enumerate("xy"):
            tape.series(f"position_{name}/{role}", when, positions[..., axis], role)
    marks = {float(stamps[0]): "clip"}
    if "train_end" in video:
        marks = {float(stamps[0]): "trained on", scalar(video, "train_end"): "held out"}
    marks[float(after[0])] = "past the end of the clip"
    tape.pictures(
        "video/image", after, (np.asarray(video["frames"][-1:]) * 0.35).astype(np.uint8)
    )  # dimmed
    tape.phases(marks)
    tape.save(path, overlay_layout(video))


def other_law(meta: Mapping[str, str]) -> str:
    """What a rollout under another law is called: by that law, where it is told."""
    return meta.get("law") or "another law"
