"""Where the motion lies in the world, and where a camera stands that has all of it in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.experiments.filmed.camera import Lens, Stand, Tremor, along, look_at
from vidphys.experiments.filmed.nuisances import Nuisances
from vidphys.experiments.filmed.scenes.scene import Course, Scene

LONG, SHORT = 640, 360  # pixels of a picture
TALL = 0.75  # width over height of a motion below which the phone is held upright
RULERS = (0.1, 0.15, 0.2, 0.3, 0.5, 1.0)  # metres
DISC_HEIGHT = 0.012  # metres of a disc's centre above its table
NEAREST, FARTHEST = 0.25, 20.0  # metres
SAMPLES = 400  # places along the course that are kept in the picture


@dataclass(frozen=True)
class View:
    """The plane of motion in the world.

    Args:
        flat: whether it lies on a table.
        floor: height of the floor, metres.
        wall: metres of the wall behind the plane.
        points: world places that must be seen, ``(p, 3)``.
        ruler: its ends, ``(2, 3)``.
    """

    flat: bool
    floor: float
    wall: float
    points: np.ndarray
    ruler: np.ndarray

    def world(self, places: np.ndarray) -> np.ndarray:
        """World points ``(…, 3)`` of places ``(…, 2)`` in the plane, metres."""
        return _world(places, self.flat)

    @property
    def plane(self) -> np.ndarray:
        """The plane's right, its up and its normal towards the camera, rows, ``(3, 3)``."""
        return np.eye(3) if self.flat else np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])

    @property
    def half_width(self) -> float:
        """Of the motion, metres."""
        return float(np.ptp(self.points[:, :2] if self.flat else self.points, 0).max() / 2)


def _world(places: np.ndarray, flat: bool) -> np.ndarray:
    x, y = places[..., 0], places[..., 1]
    if flat:
        return np.stack([x, y, np.full_like(x, DISC_HEIGHT)], -1)
    return np.stack([x, np.zeros_like(x), y], -1)


def view_of(random: np.random.Generator, scene: Scene, course: Course) -> View:
    """Lay out the room around a course."""
    inside = (course.times >= 0) & (course.times <= scene.seconds)
    some = np.linspace(0, inside.sum() - 1, SAMPLES).astype(int)
    places = course.places[inside][some].reshape(-1, 2)
    anchors = [end for link in scene.links for end in (link.a, link.b) if not isinstance(end, int)]
    corners = [corner for fixture in scene.fixtures for corner in (fixture.a, fixture.b)]
    wanted = np.concatenate([places, np.array([*anchors, *corners]).reshape(-1, 2)])
    radius = max(look.radius for look in scene.looks)
    low, high = wanted.min(0) - radius, wanted.max(0) + radius
    long = float(np.clip((high - low).max(), 0.18, None))
    length = max((r for r in RULERS if r <= 0.62 * long), default=RULERS[0])
    side = 1.0 if scene.held is None else -float(np.sign(scene.held.way[0]))
    across = (high[0] + 0.06) if side > 0 else (low[0] - 0.06)
    foot = np.array([across, low[1] + 0.01])
    ruler = np.stack([foot, foot + [0, length]])
    box = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    floor = _floor(random, scene, float(low[1]))
    return View(
        scene.flat,
        floor,
        random.uniform(0.5, 1.6),
        _world(np.concatenate([box, wanted, ruler]), scene.flat),
        _world(ruler, scene.flat) - ([0, 0, DISC_HEIGHT - 0.002] if scene.flat else [0, 0, 0]),
    )


def _floor(random: np.random.Generator, scene: Scene, low: float) -> float:
    for fixture in scene.fixtures:
        lowest = min(fixture.a[1], fixture.b[1])
        if fixture.kind == "floor":
            return lowest
        if fixture.kind == "ramp":
            return lowest - 0.04
        if fixture.kind == "rail":
            return lowest - 0.75
    return low - random.uniform(0.1, 0.6)


def stand_of(
    random: np.random.Generator, view: View, add: Nuisances, seconds: float
) -> tuple[Lens, Stand]:
    """A lens, and a camera that has all points of a view in its picture.

    Args:
        random: of what the nuisances leave open.
        view: what is to be seen.
        add: tilt, tremor, pan and lens.
        seconds: of the clip.
    """
    low, high = view.points.min(0), view.points.max(0)
    up = 1 if view.flat else 2
    upright = (high[0] - low[0]) / (high[up] - low[up]) < TALL
    width, height = (SHORT, LONG) if upright else (LONG, SHORT)
    lens = Lens.within(width, height, LONG * random.uniform(0.66, 0.8), add.radial)
    turning = Tremor.of(random, np.radians(add.shake))
    target = (low + high) / 2 + random.uniform(-0.03, 0.03, 3) * (high - low)
    pan = np.radians(add.pan)
    spare = abs(pan) * seconds / 2 + 3 * np.radians(add.shake)
    fill = random.uniform(0.68, 0.88)
    near, far = NEAREST, FARTHEST
    turns = np.radians([add.tilt, add.side, add.roll])
    for _ in range(30):
        distance = (near + far) / 2
        pose = look_at(target, view.plane, distance, *turns)
        if _fits(lens, along(view.points, *pose), fill, spare):
            far = distance
        else:
            near = distance
    pose = look_at(target, view.plane, far, *turns)
    return lens, Stand(*pose, turning, pan, seconds / 2)


def _fits(lens: Lens, points: np.ndarray, fill: float, spare: float) -> bool:
    if (points[:, 2] > -NEAREST / 2).any():
        return False
    half = np.array([lens.width, lens.height]) / 2
    off = np.abs(lens.project(points) - lens.centre)
    return bool((off < fill * half - spare * lens.focal).all())
