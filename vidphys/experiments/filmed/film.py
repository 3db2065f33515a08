"""Filming: a scene, a stage and a camera become pictures, stamps and the truth about them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from vidphys.experiments.filmed.camera import Lens, Stand, along
from vidphys.experiments.filmed.framing import View, stand_of, view_of
from vidphys.experiments.filmed.nuisances import Nuisances, nuisances, part_of
from vidphys.experiments.filmed.props import bodies
from vidphys.experiments.filmed.scenes.kinds import KINDS, STRUCTURES
from vidphys.experiments.filmed.scenes.scene import Course, Scene, course_of
from vidphys.experiments.filmed.sensor import Sensor, Shutter, timing
from vidphys.experiments.filmed.stage import Stage
from vidphys.experiments.filmed.truth import Ruler, Truth
from vidphys.seeding import derive

BEYOND = 0.2  # seconds that the course goes on before and after a clip
ROUNDS = 4  # until the row that a body is seen in agrees with the time at which it is read


@dataclass(frozen=True)
class Clip:
    """A clip that is not yet drawn.

    Args:
        seed, number: of it, from which all else follows.
        part: of the set.
        scene, course, view, add, lens, stand: see there.
    """

    seed: int
    number: int
    part: str
    scene: Scene
    course: Course
    view: View
    add: Nuisances
    lens: Lens
    stand: Stand

    @property
    def random(self) -> np.random.Generator:
        """For what is drawn; the same each time."""
        return _random(self.seed, self.number, "looks")


def clip_of(seed: int, number: int) -> Clip:
    """The clip of a seed and number; every kind comes once in as many clips as there are kinds."""
    names, block = list(KINDS), number // len(KINDS)
    order = _random(seed, block, "order").permutation(len(names))
    kind, part = names[order[number % len(names)]], part_of(number)
    random = _random(seed, number, "scene")
    return compose(KINDS[kind](random), nuisances(random, part), seed, number, part)


def compose(scene: Scene, add: Nuisances, seed: int, number: int, part: str) -> Clip:
    """Put a scene before a camera."""
    random = _random(seed, number, "view")
    course = course_of(scene, BEYOND)
    view = view_of(random, scene, course)
    lens, stand = stand_of(random, view, add, scene.seconds)
    return Clip(seed, number, part, scene, course, view, add, lens, stand)


def _random(seed: int, number: int, what: str) -> np.random.Generator:
    return np.random.default_rng(derive(seed, "filmed", what, str(number)))


def truth_of(clip: Clip) -> Truth:
    """Everything that is known of a clip, before it is drawn."""
    stamps, times, shown = timing(
        _random(clip.seed, clip.number, "timing"), clip.scene.seconds, clip.add
    )
    read = read_at(clip, times)
    places = clip.course.at(read)
    world = clip.view.world(places)
    first = clip.stand.poses(times[:1])
    still = (first[0][:, None], first[1][:, None])
    law = dict(zip(clip.scene.law.names, map(float, clip.scene.values), strict=True))
    ruler = clip.lens.project(along(clip.view.ruler, first[0][0], first[1][0]))
    return Truth(
        clip.scene.kind,
        clip.part,
        clip.seed,
        clip.number,
        (clip.lens.height, clip.lens.width),
        tuple(sorted(STRUCTURES[clip.scene.kind])),
        clip.scene.numbers,
        stamps,
        times,
        shown,
        clip.lens.project(along(world, *clip.stand.poses(read))),
        clip.lens.project(along(world, *still)),
        _radii(clip, world[0]),
        places,
        clip.scene.released,
        Ruler(float(np.linalg.norm(np.diff(clip.view.ruler, axis=0))), ruler),
        _view(clip, first[0][0], first[1][0]),
        law,
        asdict(clip.add),
    )


def _view(clip: Clip, position: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The map ``(3, 3)`` of the plane of motion into the picture of a camera without distortion."""
    corners = clip.view.world(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    origin, right, up = along(corners, position, axes)
    (cx, cy), f = clip.lens.centre, clip.lens.focal
    camera = np.array([[f, 0, -cx], [0, -f, -cy], [0, 0, -1]])
    return camera @ np.stack([right - origin, up - origin, origin], 1)


def _radii(clip: Clip, world: np.ndarray) -> np.ndarray:
    """Of bodies with all their parts, at world places ``(n, 3)``, pixels."""
    sizes = np.array([bodies.extent(look) for look in clip.scene.looks])
    return clip.lens.focal * sizes / np.linalg.norm(world - clip.stand.position, axis=-1)


def read_at(clip: Clip, times: np.ndarray) -> np.ndarray:
    """Seconds ``(t, n)`` at which the row that shows a body is read."""
    read = np.repeat(times[:, None], len(clip.scene.looks), 1)
    if not clip.add.readout:
        return read
    for _ in range(ROUNDS):
        world = clip.view.world(clip.course.at(read))
        rows = clip.lens.project(along(world, *clip.stand.poses(read)))[..., 1]
        read = times[:, None] + (rows / (clip.lens.height - 1) - 0.5) * clip.add.readout
    return read


def pictures(clip: Clip, truth: Truth) -> Iterator[np.ndarray]:
    """RGB bytes ``(H, W, 3)`` of each frame."""
    shutter = Shutter(clip.lens, clip.stand, clip.add.readout, clip.scene.seconds)
    sensor = Sensor(clip.random, clip.lens, clip.add, clip.scene.seconds)
    with Stage(
        clip.random,
        clip.scene,
        clip.course,
        clip.view,
        clip.add.clutter,
        shutter.size,
        clip.lens.focal,
        (clip.stand.position, clip.stand.axes),
    ) as stage:
        last = None
        for k, time in enumerate(truth.times):
            if last is None or truth.shown[k] == k:
                delays = read_at(clip, np.array([time]))[0] - time
                last = sensor.read(
                    [
                        shutter.bend(stage.picture(t, delays), t)
                        for t in sensor.moments(float(time)).tolist()
                    ],
                    float(time),
                )
            yield last
