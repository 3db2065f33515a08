"""Recorded tracks from a user's file, as a motion to diagnose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vidphys.data.formats import Recording, read_recording
from vidphys.diagnose.recordings.inputs import Signal
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.resting import without_resting
from vidphys.diagnose.recordings.rigid import as_rigid
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.recordings.used import Used
from vidphys.errors import InputError


@dataclass(frozen=True)
class Loaded:
    """Tracks and how the file was understood.

    Args:
        motion: the tracks.
        angles: whether coordinates are angles in radians.
        notes: what was found, a line each.
        units: in which lengths are told.
        used: which frames of the recording the motion is of; all of it unless given.
    """

    motion: Motion
    angles: bool
    notes: tuple[str, ...]
    units: Units = Units()
    used: Used | None = None


def read_tracks(
    path: Path, columns: Mapping[str, str] | None = None, interval: float | None = None
) -> Loaded:
    """Read tracks of any known format; pixels are turned, so that y points upwards.

    Args:
        path: the file.
        columns, interval: see :class:`vidphys.data.formats.TrackFormat`.

    Raises:
        InputError: a file that cannot be read, that does not hold tracks, or too few of them.

    Example:
        >>> import tempfile
        >>> table = Path(tempfile.mkdtemp()) / 'tracks.csv'
        >>> seconds = np.arange(10)[None] / 30
        >>> write_tracks(table, Motion(np.zeros((1, 10, 1, 2)), seconds, np.ones((1, 1))))
        >>> read_tracks(table).motion.positions.shape  # clips, frames, bodies, space
        (1, 10, 1, 2)
    """
    found = read_recording(path, columns, interval)
    if found.times is None:
        raise InputError(
            f"{path}: no times in seconds; give the seconds between frames as `interval`, or say "
            f"which column they are with `columns` time=NAME; read were {'; '.join(found.notes)}"
        )
    if found.unit == "picture":
        raise InputError(
            f"{path}: places in shares of a picture whose sides are not told; multiply them by its "
            "width and height, and call them u and v"
        )
    positions = found.positions
    if found.unit == "pixels":
        positions = positions * np.where(np.arange(positions.shape[-1]) == 1, -1.0, 1.0)
    mass = np.ones((len(positions), positions.shape[2])) if found.mass is None else found.mass
    try:
        motion = Motion(positions, found.times, mass, found.coupling, _inputs(found))
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    shape = (
        f"{_count(motion.clips, 'clip')} of {positions.shape[1]} frames, "
        f"{_count(motion.bodies, 'body', 'bodies')} in {_count(motion.space, 'dimension')}, "
        f"{motion.interval:.4g} s between frames"
    )
    notes = (*found.notes, shape)
    if found.inputs is not None and not motion.inputs:
        named = ", ".join(found.input_names)
        notes = (*notes, f"{named} not taken: which of several coordinates it pushes is not told")
    angles = found.unit == "angles"
    if not angles:
        motion, resting = without_resting(motion)
        motion, rigid = as_rigid(motion, Units(found.length, 1.0))
        notes = (*notes, *resting, *rigid)
    return Loaded(motion, angles, notes, Units("rad" if angles else found.length))


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def _inputs(found: Recording) -> tuple[Signal, ...]:
    """Of each clip, where there is one coordinate that they can push."""
    if found.inputs is None or found.times is None or found.positions.shape[2:] != (1, 1):
        return ()
    pairs = zip(found.times, found.inputs, strict=True)
    return tuple(Signal(found.input_names, times, values) for times, values in pairs)


def write_tracks(path: Path, motion: Motion) -> None:
    """Write the tracks of one clip as a table that :func:`read_tracks` reads."""
    import pyarrow as pa
    import pyarrow.csv as pc

    columns = {"t": motion.times[0]}
    for body in range(motion.bodies):
        for axis in range(motion.space):
            columns[f"{'xyz'[axis]}{body + 1}"] = motion.positions[0, :, body, axis]
    pc.write_csv(pa.table(columns), path)
