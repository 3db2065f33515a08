"""Projects of Tracker (Open Source Physics): an author's tracks in the author's axes and scale."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from vidphys.data.formats.base import Recording
from vidphys.data.formats.bounded import reading, require_room, require_text, unpacked
from vidphys.errors import InputError

MARK = b"org.opensourcephysics"
CALLED = "org.opensourcephysics.cabrillo.tracker.{}"
FRAME = re.compile(r"^\[(\d+)\]$")


@dataclass(frozen=True)
class Axes:
    """Tracker's coordinate system: where it lies in the picture, from a frame on.

    Args:
        frame: first frame that it holds for.
        origin: pixels from the top left corner.
        angle: radians from the picture's horizontal to the x axis, counter-clockwise.
        scale: pixels in a unit of length along the picture's width and height.
    """

    frame: int
    origin: tuple[float, float]
    angle: float
    scale: tuple[float, float]

    def world(self, x: float, y: float) -> tuple[float, float]:
        """A place of the picture in the axes' unit, y upwards."""
        right, up = x - self.origin[0], self.origin[1] - y
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        return (right * cos + up * sin) / self.scale[0], (up * cos - right * sin) / self.scale[1]


def is_project(path: Path) -> bool:
    """Whether a file is Tracker's, or an archive that holds one."""
    try:
        return MARK in _xml(path)[:4000]
    except InputError:
        return False


def read_project(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The point masses of a project, in its axes.

    Args:
        path: a ``.trk``, or a ``.trz`` or ``.zip`` with one in it.
        columns: ``body=NAME`` takes one of the tracks; they have no other columns.
        interval: seconds between frames, in place of the project's.
    """
    root, found = _marked(path, columns)
    axes, step = _axes(root), _milliseconds(root, interval)
    places = found.places.copy()
    for row, frame in enumerate(found.frames.tolist()):
        held = [one for one in axes if one.frame <= frame] or axes[:1]
        for body, at in enumerate(found.places[row].tolist()):
            places[row, body] = held[-1].world(*at)
    clip = _object(root, "videoclip")
    first = float(_value(clip, "startframe", "0"))
    began = float(_value(clip, "starttime", "0"))
    times = (began + (found.frames - first) * step) / 1000
    scaled = any(one.scale != (1.0, 1.0) for one in axes)
    unit = _value(root, "length_unit", "m") if scaled else "px"
    scale = f"{axes[0].scale[0]:.4g} px in 1 {unit}" if scaled else "no scale, so in pixels"
    note = f"{found.said}: {scale}, y upwards in its axes, {step:.4g} ms a frame, {found.seen}"
    weights = _weights(root, list(found.names))
    return Recording(places[None], times[None], mass=weights, notes=(note,), length=unit)


def read_marks(path: Path, columns: Mapping[str, str], _interval: float | None) -> Recording:
    """The point masses of a project where they were marked: pixels of the clip, by its frames."""
    root, found = _marked(path, columns)
    weights = _weights(root, list(found.names))
    notes = (f"{found.said}: pixels, {found.seen}",)
    places = found.places[None] - 0.5  # Tracker counts from the corner, not the centre, of a pixel
    return Recording(places, None, "pixels", weights, None, notes, "px", frames=found.frames)


@dataclass(frozen=True)
class Marks:
    """What was marked, a row for each frame from the first to the last.

    Args:
        names: of the tracks that are taken.
        frames: numbers ``(t,)``.
        places: pixels ``(t, n, 2)``, NaN where nothing was marked.
        said, seen: whose tracks these are, and when, in words.
    """

    names: tuple[str, ...]
    frames: np.ndarray
    places: np.ndarray
    said: str
    seen: str


def _marked(path: Path, columns: Mapping[str, str]) -> tuple[ET.Element, Marks]:
    text = _xml(path)
    if b"<!ENTITY" in text or b"<!DOCTYPE" in text:
        raise InputError("not a project of Tracker (it declares entities)")
    with reading("a project of Tracker"):
        root = ET.fromstring(text)
    every = {name: marks for name, marks, _ in _masses(root)}
    wanted = _wanted(every, columns)
    if not wanted:
        raise InputError("no point mass is marked in this project; mark one in Tracker, and save")
    frames = sorted({frame for name in wanted for frame in every[name]})
    require_room((frames[-1] - frames[0], len(wanted), 2), 8, "marks")
    stride = math.gcd(*(b - a for a, b in zip(frames, frames[1:], strict=False))) or 1
    grid = np.arange(frames[0], frames[-1] + 1, stride)
    places = np.full((len(grid), len(wanted), 2), np.nan)
    for body, name in enumerate(wanted):
        for frame, at in every[name].items():
            places[(frame - frames[0]) // stride, body] = at
    left = [name for name in every if name not in wanted]
    also = f"; not taken: {', '.join(left)}" if left else ""
    seen = f"marked from frame {frames[0]} to {frames[-1]}{also}"
    said = f"Tracker's tracks {', '.join(wanted)}"
    return root, Marks(tuple(wanted), grid, places, said, seen)


def _xml(path: Path) -> bytes:
    """The project's text; that of an archive is the first in it.

    Raises:
        InputError: an archive without one.
    """
    if path.suffix.lower() == ".trk":
        require_text(path)
        return path.read_bytes()
    with reading("an archive"), ZipFile(path) as archive:
        found = unpacked(archive, ".trk")
    if found is None:
        raise InputError("no .trk in this archive; unpack it, and give the table or clip")
    return found


def _wanted(every: Mapping[str, object], columns: Mapping[str, str]) -> list[str]:
    if not columns:
        return list(every)
    if set(columns) != {"body"} or columns["body"] not in every:
        raise InputError(
            f"`columns`: a project of Tracker has the tracks {', '.join(every)}; take one with "
            "`columns` body=NAME"
        )
    return [columns["body"]]


def _properties(element: ET.Element) -> dict[str, ET.Element]:
    return {p.get("name", ""): p for p in element.findall("property")}


def _value(element: ET.Element | None, name: str, default: str) -> str:
    found = None if element is None else _properties(element).get(name)
    return default if found is None or not found.text else found.text.strip()


def _object(element: ET.Element, name: str) -> ET.Element | None:
    found = _properties(element).get(name)
    return None if found is None else found.find("object")


def _frames(element: ET.Element) -> Iterator[tuple[int, ET.Element]]:
    """Frame number and content of each entry of an object's ``framedata``."""
    found = _properties(element).get("framedata")
    for entry in [] if found is None else found.findall("property"):
        number, held = FRAME.match(entry.get("name", "")), entry.find("object")
        if number and held is not None:
            yield int(number[1]), held


def _axes(root: ET.Element) -> list[Axes]:
    coords = _object(root, "coords")
    found = []
    for frame, held in _frames(coords) if coords is not None else ():
        x, y, angle, wide, high = (
            float(_value(held, name, default))
            for name, default in (
                ("xorigin", "0"),
                ("yorigin", "0"),
                ("angle", "0"),
                ("xscale", "1"),
                ("yscale", "1"),
            )
        )
        if not (math.isfinite(wide * high) and wide * high != 0):
            raise InputError(f"scales of {wide:g} and {high:g} pixels in frame {frame}")
        found.append(Axes(frame, (x, y), math.radians(angle), (wide, high)))
    return sorted(found, key=lambda one: one.frame) or [Axes(0, (0.0, 0.0), 0.0, (1.0, 1.0))]


def _milliseconds(root: ET.Element, interval: float | None) -> float:
    """Of a frame."""
    if interval is not None and interval > 0:
        return 1000 * interval
    clip = _object(root, "videoclip")
    video = None if clip is None else _object(clip, "video")
    for element in (_object(root, "clipcontrol"), video):
        step = float(_value(element, "delta_t", "0"))
        if step > 0:
            return step
    raise InputError("says nothing of the time between frames; give its seconds as `interval`")


def _masses(root: ET.Element) -> Iterator[tuple[str, dict[int, tuple[float, float]], float]]:
    """Name, marks (pixels, by frame) and mass of each point mass that is marked."""
    for element in root.iter("object"):
        if element.get("class") != CALLED.format("PointMass"):
            continue
        marks = {
            frame: (float(_value(held, "x", "nan")), float(_value(held, "y", "nan")))
            for frame, held in _frames(element)
        }
        if marks:
            yield _value(element, "name", "mass"), marks, float(_value(element, "mass", "1"))


def _weights(root: ET.Element, wanted: list[str]) -> np.ndarray | None:
    """Masses, of several bodies: that of one alone changes nothing in how it moves."""
    mass = {name: value for name, _, value in _masses(root)}
    return np.array([[mass[name] for name in wanted]]) if len(wanted) > 1 else None
