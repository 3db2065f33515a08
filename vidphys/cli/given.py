"""What ``vidphys diagnose`` is given: whether the options fit it, and the tracks that it holds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from vidphys.cli.options import make_binder, refuse, require_file
from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.diagnose import DiagnoseConfig
    from vidphys.data.frames import Frames
    from vidphys.diagnose.recordings.tables import Loaded
    from vidphys.diagnose.recordings.units import Units


def check(config: DiagnoseConfig) -> None:
    """Whether the input is there and its options fit it, before anything slow is imported.

    Raises:
        InputError: it is not, or they do not.
    """
    from vidphys.data.dataset import is_clip
    from vidphys.data.formats import FORMATS

    if is_clip(config.input):
        refuse(config, ("columns", "interval", "angles"), f"{config.input} is a clip, not a table")
        told = config.binder, config.bodies, config.shadow
        if told != (None, None, None) or config.given:
            make_binder(*told, config)
    else:
        names = (*config.given, "binder", "bodies", "shadow", "rate", "scale", "video", "look")
        refuse(config, names, f"{config.input} is not a clip")
    if is_clip(config.input) and not config.input.exists():
        return
    require_file(config.input, "give a table of tracks or a clip")
    if not any(f.sniff(config.input) for f in FORMATS.values()):
        known = dict.fromkeys(suffix for f in FORMATS.values() for suffix in f.suffixes)
        if (suffix := config.input.suffix.lower()) in known:
            raise InputError(
                f"{config.input}: is called {suffix}, but no table and no clip is in it"
            )
        raise InputError(
            f"{config.input}: neither a table nor a clip that is known ({', '.join(known)})"
        )


def load(config: DiagnoseConfig, given: dict[str, str]) -> tuple[Loaded, Frames | None]:
    """The tracks, and the pictures where there are any.

    Args:
        config: names the input.
        given: what columns of a table are.

    Raises:
        InputError: an input that cannot be read, or without the frames that are asked for.
    """
    from vidphys.data.dataset import is_clip
    from vidphys.diagnose.recordings.tables import Loaded, read_tracks
    from vidphys.diagnose.recordings.used import Used

    if is_clip(config.input):
        from vidphys.data.video import ClipSelection
        from vidphys.diagnose.mechanisms.bodies.lawful import of_lawful_bodies
        from vidphys.diagnose.recordings.clips import follow_clip

        selection = ClipSelection(config.start, config.stop, rate=config.rate)
        binder = make_binder(config.binder, config.bodies, config.shadow, config, count=True)
        followed = follow_clip(config.input, selection, binder)
        motion, video, notes = followed.motion, followed.video, followed.notes
        units = told_in(config, video.size)
        if units.plane is not None:
            motion = replace(motion, positions=units.plane.flat(motion.positions))
        if config.bodies is None and not config.given:
            motion, left_out = of_lawful_bodies(motion)
            notes = (*notes, *left_out)
        return Loaded(motion, False, notes, units, followed.used), video.frames
    loaded = read_tracks(config.input, given, config.interval)
    try:
        motion = loaded.motion.cut(config.start, config.stop)
    except ValueError as error:
        raise InputError(f"--start {config.start} --stop {config.stop}: {error}") from error
    used = Used(loaded.motion.positions.shape[1], config.start)
    loaded = replace(loaded, motion=motion, used=used)
    named = loaded.angles or config.angles or loaded.units.name
    return loaded if named else _perhaps_turning(loaded), None


def _perhaps_turning(loaded: Loaded) -> Loaded:
    """Coordinates whose unit is not told: angles, where they move as such."""
    from vidphys.diagnose.mechanisms.turning import turned, turns_in

    unit = turns_in(loaded.motion)
    if not unit:
        return loaded
    notes = [
        f"it moves as a pendulum's angle in {unit}, and is taken for one; --columns x[m]=NAME says "
        "that it is a length"
    ]
    if unit == "degrees":
        notes.append("other verbs read the table so with --columns angle[deg]=NAME")
    motion = turned(loaded.motion, unit)
    return replace(loaded, motion=motion, angles=True, notes=(*loaded.notes, *notes))


def told_in(config: DiagnoseConfig, size: tuple[int, int]) -> Units:
    """In which lengths of a clip are told, whose pictures are of (height, width).

    Raises:
        InputError: a ``--scale`` that cannot be read.
    """
    from vidphys.diagnose.recordings.units import Units, scale_of

    if config.scale is None:
        return Units("px", max(size) / 2)  # pixels of a unit of the motion
    try:
        return scale_of(config.scale, size)
    except ValueError as error:
        raise InputError(f"--scale {config.scale}: {error}") from error
