"""What a file format is: which files are of it, and what it reads them as."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from registry import Registry
from vidphys.errors import InputError

Unit = Literal["world", "pixels", "picture", "angles"]


@dataclass(frozen=True)
class Recording:
    """What a file of tracks says.

    Args:
        positions: ``(e, t, n, d)``, e clips of n bodies; NaN where a body was not seen.
        times: seconds of each frame, ``(e, t)``; ``None`` where the file has none.
        unit: of the positions: ``world`` (any length, y upwards), ``pixels`` (from the centre of
            the top left one, the second coordinate downwards), ``picture`` (shares of its width and
            height, from its top left corner, likewise) or ``angles`` (radians).
        mass: of the bodies, ``(e, n)``; ``None`` where nothing is said.
        coupling: strength of the law in each clip, ``(e,)``, where it was set and is known.
        notes: how the file was understood, a line each.
        length: the unit that positions are counted in, as the file says it: ``m``, ``cm``, ``px``,
            ``rad``; empty where it says nothing.
        inputs: what drives the bodies and is known, at each frame, ``(e, t, m)``.
        input_names: of the columns that they are.
        frames: number of the clip's frame that each row is of, ``(t,)``, where the file says it.
    """

    positions: np.ndarray
    times: np.ndarray | None
    unit: Unit = "world"
    mass: np.ndarray | None = None
    coupling: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    length: str = ""
    inputs: np.ndarray | None = None
    input_names: tuple[str, ...] = ()
    frames: np.ndarray | None = None


@dataclass(frozen=True)
class Format:
    """A format of files.

    Args:
        suffixes: of its files, in lower case, with the dot; none: any, of files that no other
            format takes.
        read: see the subclasses.
        looks: whether the content of a file with such a suffix is of this format, where the
            suffix alone does not say.
    """

    suffixes: tuple[str, ...]
    read: Callable[..., object]
    looks: Callable[[Path], bool] | None = None

    def sniff(self, path: Path) -> bool:
        """Whether a file that is there is of this format."""
        called = not self.suffixes or path.suffix.lower() in self.suffixes
        return called and (self.looks is None or self.looks(path))


@dataclass(frozen=True)
class TrackFormat(Format):
    """Positions of bodies through time.

    ``read(path, columns, interval)`` gives a :class:`Recording`: ``columns`` says what some of
    its columns are, where their names do not tell, and ``interval`` (seconds between frames, or
    ``None``) stands in for times that it does not have. It raises ``ValueError`` with one line.

    Args:
        in_picture: reads the same as places in the picture that they were marked in, where
            ``read`` gives them in axes of their own.
        table: gives all its columns by name, numbers or words, ``(rows,)`` each; not given where
            it holds nothing but places.
    """

    read: Callable[[Path, Mapping[str, str], float | None], Recording]
    in_picture: Callable[[Path, Mapping[str, str], float | None], Recording] | None = None
    table: Callable[[Path], Mapping[str, np.ndarray]] | None = None


Frames = Iterator[tuple[np.ndarray, float]]


@dataclass(frozen=True)
class ClipFormat(Format):
    """Pictures through time.

    ``read(path)`` gives the frames per second and the number of frames that the file declares (0
    where it says nothing), and an iterator over its frames: RGB bytes ``(H, W, 3)``, row 0 on top,
    and the seconds of each, NaN where the file has none. It raises ``ValueError`` with one line.

    Args:
        package: that decodes them, by the name under which it is installed; a record says its
            version. Empty: whoever registers the format does.
    """

    read: Callable[[Path], tuple[float, int, Frames]]
    package: str = ""


FORMATS: Registry[Format] = Registry("format", "vidphys.formats")
Kind = TypeVar("Kind", bound=Format)


def format_of(path: Path, kind: type[Kind]) -> Kind | None:
    """The first format of this kind that a file is of."""
    return next((format for _, format in _takers(path, kind)), None)


def suffixes_of(kind: type[Format]) -> tuple[str, ...]:
    """Of all formats of a kind."""
    every = (f.suffixes for f in FORMATS.values() if isinstance(f, kind))
    return tuple(dict.fromkeys(suffix for suffixes in every for suffix in suffixes))


def read_recording(
    path: Path,
    columns: Mapping[str, str] | None = None,
    interval: float | None = None,
    in_picture: bool = False,
) -> Recording:
    """Read a file of tracks by the format that it is of.

    Args:
        path: of the file.
        columns, interval: see :class:`TrackFormat`.
        in_picture: whether places are wanted as they lie in a clip's picture.

    Raises:
        InputError: no such file, no format that is known, or a file that holds no tracks.
    """
    format = _of_tracks(path)
    read = (in_picture and format.in_picture) or format.read
    try:
        return read(path, columns or {}, interval)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def read_table(path: Path) -> dict[str, np.ndarray]:
    """All columns of a file of tracks by name, ``(rows,)`` each; none where it has no table.

    Raises:
        InputError: see :func:`read_recording`.
    """
    format = _of_tracks(path)
    try:
        return {} if format.table is None else dict(format.table(path))
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def _of_tracks(path: Path) -> TrackFormat:
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a table of tracks or a clip")
    format = format_of(path, TrackFormat)
    if format is None:
        known = ", ".join(suffixes_of(TrackFormat))
        raise InputError(
            f"{path}: not a table that is known ({known}); a text of numbers has a line of names "
            "such as t,x,y above them"
        )
    return format


def sources_of(*paths: Path) -> dict[str, str]:
    """Where the formats of files come from that are not ours, for a record."""
    first = (next((name for name, _ in _takers(path, Format)), None) for path in paths)
    return FORMATS.sources(*sorted({name for name in first if name}))


def _takers(path: Path, kind: type[Kind]) -> Iterator[tuple[str, Kind]]:
    """The formats of a kind that a file is of: those of its suffix first, also other packages'."""
    for by_name in (True, False):
        for name, format in FORMATS.items():
            if isinstance(format, kind) and bool(format.suffixes) == by_name and format.sniff(path):
                yield name, format
