"""A scene set up before the camera: its bodies, what they hang from, the room, hand and clutter."""

from __future__ import annotations

from typing import Self

import numpy as np

from vidphys.experiments.filmed.framing import View
from vidphys.experiments.filmed.props import bodies, clutter, hand, room
from vidphys.experiments.filmed.props.pieces import Piece, between, pointing, turned
from vidphys.experiments.filmed.scenes.scene import Anchor, Course, Link, Scene
from vidphys.experiments.filmed.studio import Light, Studio

Random = np.random.Generator
RULER_WIDTH = 0.035  # metres


class Stage:
    """What stands before the camera, and how it looks at a time.

    Args:
        random: of all that the law leaves open.
        scene: see :class:`Scene`.
        course: where its bodies are.
        view: where the plane of motion and the room are.
        crowded: whether other things move.
        size, focal: of the studio's pictures.
        camera: its position and axes.
    """

    def __init__(
        self,
        random: Random,
        scene: Scene,
        course: Course,
        view: View,
        crowded: bool,
        size: tuple[int, int],
        focal: float,
        camera: tuple[np.ndarray, np.ndarray],
    ) -> None:
        self._scene, self._course, self._view = scene, course, view
        self._others = _others(random, view) if crowded else []
        self._studio = Studio(
            random,
            self._still(random),
            self._groups(),
            room.skins(random, len(scene.looks)),
            _light(random, view),
            size,
            focal,
            camera,
            _walls(view),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._studio.__exit__()

    def picture(self, time: float, delays: np.ndarray) -> np.ndarray:
        """RGB bytes at a time.

        Args:
            time: seconds.
            delays: by which each body is seen later, seconds, ``(n,)``.
        """
        places = self._course.at((time + delays)[None])[0]
        for k, look in enumerate(self._scene.looks):
            turn = look.spin * time
            if look.rolls:
                turn -= float(places[k, 0] - self._course.places[0, k, 0]) / look.radius
            axes = turned(z=turn) if self._scene.flat else turned(y=-turn)
            self._studio.pose(f"body{k}", self._view.world(places[k]), axes)
        for k, link in enumerate(self._scene.links):
            self._studio.stretch(f"link{k}", self._line(link, places))
        self._hand(time, places)
        for k, mover in enumerate(self._others):
            self._studio.pose(f"mover{k}", *mover.at(time))
        return self._studio.picture()

    def _still(self, random: Random) -> list[Piece]:
        view, pieces = self._view, []
        if self._scene.flat:
            pieces += room.table(random, view.half_width)
        else:
            pieces += room.room(random, view.floor, view.wall)
        bracket = bool(random.random() < 0.4)
        for each in self._scene.fixtures:
            pieces += bodies.fixture(each, view.floor, view.wall, bracket)
        low, high = view.ruler
        lies = between(low, high, 0.001, "ruler")
        size = (0.002, RULER_WIDTH / 2, lies.size[1])
        return [*pieces, Piece("box", size, "ruler", lies.place, lies.axes)]

    def _groups(self) -> dict[str, list[Piece]]:
        looks = self._scene.looks
        groups = {f"body{k}": bodies.body(look, f"body{k}") for k, look in enumerate(looks)}
        for k, link in enumerate(self._scene.links):
            radius = bodies.RADII.get(link.kind, bodies.WIRE)
            skin = "thread" if link.kind == "string" else "metal"
            bars = 1 if link.kind != "spring" else bodies.COILS * bodies.CORNERS
            groups[f"link{k}"] = [Piece("capsule", (radius, 0.01), skin) for _ in range(bars)]
        if self._scene.held is not None:
            groups["hand"] = hand.hand(looks[self._scene.held.body].radius)
        return groups | {f"mover{k}": mover.pieces for k, mover in enumerate(self._others)}

    def _line(self, link: Link, places: np.ndarray) -> np.ndarray:
        ends = [self._end(anchor, places) for anchor in (link.a, link.b)]
        if link.kind != "spring":
            return np.stack(ends)
        way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        for side, anchor in enumerate((link.a, link.b)):
            if isinstance(anchor, int):
                reach = bodies.reach(self._scene.looks[anchor])
                ends[side] = ends[side] + (way if side == 0 else -way) * reach
        return bodies.coil(ends[0], ends[1], pointing(way))

    def _end(self, anchor: Anchor, places: np.ndarray) -> np.ndarray:
        return self._view.world(places[anchor] if isinstance(anchor, int) else np.array(anchor))

    def _hand(self, time: float, places: np.ndarray) -> None:
        held = self._scene.held
        if held is None:
            return
        let_go = self._course.at(np.full((1, len(places)), held.seconds))[0, held.body]
        grip = places[held.body] if time < held.seconds else let_go
        place = hand.course(held, grip[None], np.array([time]))[0]
        self._studio.pose("hand", self._view.world(place), hand.axes(held))


def _light(random: Random, view: View) -> Light:
    way = np.array([random.uniform(-0.6, 0.6), random.uniform(0.6, 1.1), -1.0])
    if view.flat:
        way[1] = random.uniform(-0.5, 0.5)
    strength = random.uniform(0.4, 0.7)
    ambient = random.uniform(0.95, 1.15) - strength
    reach = float(np.clip(3 * view.half_width + 1.5, 2.2, 4.0))
    return Light(way / np.linalg.norm(way), strength, ambient, view.points.mean(0), reach)


def _others(random: Random, view: View) -> list[clutter.Mover]:
    if view.flat:
        return clutter.over_table(random, float(np.abs(view.points[:, 1]).max()))
    return clutter.movers(random, view.floor, view.wall, view.half_width)


def _walls(view: View) -> list[tuple[np.ndarray, float]]:
    """The floor or the table, and the wall."""
    floor = np.array([0.0, 0.0, 1.0]), 0.0 if view.flat else view.floor
    return [floor] if view.flat else [floor, (np.array([0.0, 1.0, 0.0]), view.wall)]
