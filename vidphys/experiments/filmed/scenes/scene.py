"""What a filmed scene is: a law with its numbers, what the bodies look like, and who lets go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vidphys.experiments.filmed.laws.law import Law

FINE = 9600.0  # places a second, between which a path is straight: 0.1 mm of a falling ball's kink
THROW = 0.22  # seconds in which a hand brings a ball to its speed
CARRY = 0.6  # share of the time before the release in which a hand moves; then it waits

Place = tuple[float, float]
Anchor = int | Place  # a body, or a place in the plane of motion


@dataclass(frozen=True)
class Number:
    """One number of the truth.

    Args:
        name: for example ``length``.
        value, unit: SI.
        body: whose, counted from 0; ``None`` of the scene.
    """

    name: str
    value: float
    unit: str
    body: int | None = None


@dataclass(frozen=True)
class Look:
    """A body as it is drawn.

    Args:
        shape: ball, weight, disc, cart or cup.
        radius: metres.
        rolls: whether it turns as it goes along a line.
        spin: radians per second that it turns by itself.
    """

    shape: str
    radius: float
    rolls: bool = False
    spin: float = 0.0


@dataclass(frozen=True)
class Link:
    """A string, rod or spring between two anchors."""

    kind: str
    a: Anchor
    b: Anchor


@dataclass(frozen=True)
class Fixture:
    """Something that stands still: a stand that ends at a place, a wall, a floor, a ramp, a rail.

    Args:
        kind: stand, wall, floor, ramp or rail.
        a, b: its ends in the plane of motion, metres; a stand is a single place.
    """

    kind: str
    a: Place
    b: Place


@dataclass(frozen=True)
class Held:
    """A hand that holds a body before the law begins, and then stays in view.

    Args:
        body: which.
        seconds: until it lets go.
        way: unit vector from the body to the hand.
        pivot: about which it carries the body; it comes in a straight line where not given.
        velocity: at which it throws, m/s.
    """

    body: int
    seconds: float
    way: Place
    pivot: Place | None = None
    velocity: Place = (0.0, 0.0)


@dataclass(frozen=True)
class Scene:
    """A scene with truth; places are in the plane of motion, metres.

    Args:
        kind: name of the scene, of :data:`~vidphys.experiments.filmed.scenes.kinds.KINDS`.
        law, values: what moves the bodies.
        numbers: the truth that a diagnosis can be held to.
        seconds: of the clip, the time before a release among them.
        looks: of the bodies.
        links, fixtures: what they hang from, and what stands around.
        flat: whether the plane is a table seen from above.
        held: by whom, before the law begins.
    """

    kind: str
    law: Law
    values: tuple[float, ...]
    numbers: tuple[Number, ...]
    seconds: float
    looks: tuple[Look, ...]
    links: tuple[Link, ...] = ()
    fixtures: tuple[Fixture, ...] = ()
    flat: bool = False
    held: Held | None = None

    @property
    def released(self) -> float:
        """Seconds from the clip's begin until the law holds."""
        return 0.0 if self.held is None else self.held.seconds


@dataclass(frozen=True)
class Course:
    """Where the bodies of a scene are at any time of the clip, and a little beyond.

    Args:
        times: ``(f,)``, seconds.
        places: ``(f, n, 2)``, metres.
    """

    times: np.ndarray
    places: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """Places ``(t, n, 2)`` of the bodies, each at its own times ``(t, n)``."""
        bodies = [
            np.stack([np.interp(times[:, n], self.times, self.places[:, n, d]) for d in (0, 1)], -1)
            for n in range(self.places.shape[1])
        ]
        return np.stack(bodies, 1)


def course_of(scene: Scene, beyond: float) -> Course:
    """The course from ``beyond`` seconds before the clip to so long after it."""
    times = np.arange(-beyond, scene.seconds + beyond, 1 / FINE)
    since = times - scene.released
    places = scene.law.path(np.array(scene.values), np.maximum(since, 0.0))
    if scene.held is not None:
        before = since < 0
        body = scene.held.body
        places[before, body] = _carried(scene.held, places[0, body], since[before])
    elif beyond > 0:
        places = _led_in(places, since)
    return Course(times, places)


def _led_in(places: np.ndarray, since: np.ndarray) -> np.ndarray:
    """Before its begin a body without a hand moves as it does at its begin."""
    first = int(np.searchsorted(since, 0.0))
    velocity = (places[first + 2] - places[first + 1]) * FINE
    before = np.minimum(since, 0.0)[:, None, None]
    return places + velocity * before


def _carried(held: Held, start: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Places ``(t, 2)`` of a held body at seconds before its release (negative)."""
    velocity = np.array(held.velocity)
    if velocity.any():
        left = np.maximum(before + THROW, 0.0)
        return start - velocity * THROW / 2 + velocity * left[:, None] ** 2 / (2 * THROW)
    share = np.clip((before + held.seconds) / (CARRY * held.seconds), 0, 1)
    share = share**2 * (3 - 2 * share)
    if held.pivot is None:
        return start + np.array(held.way) * 0.15 * (1 - share[:, None])
    arm = start - np.array(held.pivot)
    angle, length = np.arctan2(arm[0], -arm[1]), np.hypot(*arm)
    turned = angle * (0.7 + 0.3 * share)
    return np.array(held.pivot) + length * np.stack([np.sin(turned), -np.cos(turned)], -1)


def numbers_of(pairs: Sequence[tuple[str, float, str]], body: int | None = None) -> list[Number]:
    """Numbers of one body, or of the scene, from name, value and unit."""
    return [Number(name, float(value), unit, body) for name, value, unit in pairs]
