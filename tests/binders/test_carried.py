"""Bodies that no background shows: they go less far than they are wide, or all behind moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from binders import points
from binders.carried import drawn_along
from binders.hypotheses import Hypothesis
from binders.motion import MotionBinder
from binders.outline import outlined
from binders.points import carried, groups
from tests.binders.test_motion import HEIGHT, WIDTH, draw, pixels, still, times

T = np.arange(60)
SIDE = 21  # pixels of a box that is wider than it goes
BOX = np.stack([50 + 5 * np.cos(0.3 * T), np.full(60, 60.0)], 1)
OTHER = np.stack([95 + 4 * np.sin(0.47 * T), np.full(60, 58.0)], 1)


def box(path: np.ndarray, seed: int, frames: np.ndarray) -> np.ndarray:
    """The frames with a box of many colours, whose middle goes along a path."""
    rng = np.random.default_rng(seed)
    paint = ndimage.zoom(rng.uniform(20, 235, (5, 5, 3)), (SIDE / 5, SIDE / 5, 1), order=1)
    room = np.zeros((HEIGHT, WIDTH, 4))
    y, x = HEIGHT // 2 - SIDE // 2, WIDTH // 2 - SIDE // 2
    room[y : y + SIDE, x : x + SIDE] = np.concatenate([paint, np.ones((SIDE, SIDE, 1))], -1)
    drawn = []
    for image, centre in zip(frames, path, strict=True):
        move = centre - [WIDTH // 2, HEIGHT // 2]
        seen = ndimage.shift(room, (move[1], move[0], 0), order=1)
        drawn.append(image * (1 - seen[..., 3:]) + seen[..., :3])
    return np.clip(np.stack(drawn), 0, 255).astype(np.uint8)


def boxes() -> np.ndarray:
    return box(OTHER, 5, box(BOX, 4, draw(np.zeros((60, 0, 2)), still())))


@pytest.mark.slow
def test_two_bodies_that_go_less_far_than_they_are_wide() -> None:
    found = MotionBinder(bodies=None)(boxes(), times())
    assert found.tracks.positions.shape[2] == 2
    tracks = pixels(found)
    for path in (BOX, OTHER):
        off = tracks - path[:, None]
        off = off - np.median(off, 0)
        assert np.sqrt((off**2).sum(-1).mean(0)).min() < 0.3


def test_a_body_before_a_crowd() -> None:
    """All of the wall behind it goes here and there."""
    rng = np.random.default_rng(8)
    wall = ndimage.gaussian_filter(rng.normal(size=(HEIGHT, 4 * WIDTH, 3)), (2, 2, 0))
    wall = 120 + 25 * wall / wall.std()
    steps = np.cumsum(ndimage.gaussian_filter1d(rng.normal(size=60), 2)) * 6
    places = np.clip(np.rint(150 + steps), 0, 3 * WIDTH).astype(int)
    frames = np.stack([wall[:, place : place + WIDTH] for place in places])
    path = np.stack([np.full(60, 64.0), 48 + 20 * np.cos(0.25 * T)], 1)
    clip = box(path, 4, frames)
    behind, nothing = np.median(clip, 0), np.zeros(clip.shape[:3], bool)
    ways = groups(carried(clip, np.ones((HEIGHT, WIDTH), bool)), float(HEIGHT))
    bodies = [outlined(way.positions, clip, behind, nothing) for way in ways]
    off = [np.nanmax(np.linalg.norm(b.positions - path, axis=-1)) for b in bodies if b is not None]
    assert min(off) < 1.5
    best = [b for b in bodies if b is not None][int(np.argmin(off))]
    assert np.nanmedian(best.size) == pytest.approx(SIDE / np.sqrt(np.pi), rel=0.15)


def test_corners_of_two_bodies_are_two_groups() -> None:
    frames = boxes()
    found = groups(carried(frames, np.ones((HEIGHT, WIDTH), bool)), float(HEIGHT))
    first = [next(found), next(found)]
    for path in (BOX, OTHER):
        off = [g.positions - path for g in first]
        assert min(np.sqrt(np.var(o, 0).sum()) for o in off) < 0.15


def test_corners_that_stay_with_an_edge_behind_the_body_are_left() -> None:
    path = np.stack([3.0 * T, 0 * T], 1)
    path[:7] = path[12]  # an edge that the body passes, on which its corners stay
    path[30] = np.nan
    kept = points._longest_way(path)
    assert not kept[:7].any() and kept[7:30].all() and kept[31:].all()
    bounces = np.stack([3.0 * np.abs(T - 20), 0 * T], 1)
    assert points._longest_way(bounces).all()


def hypothesis(path: np.ndarray, size: float) -> Hypothesis:
    column = np.full(60, size)
    return Hypothesis(path, column, column, column, np.zeros((60, 3)), column, column)


def test_what_bodies_draw_along_is_no_body() -> None:
    bodies = [hypothesis(BOX, 10.0), hypothesis(OTHER, 10.0)]
    noise = np.random.default_rng(0).normal(scale=0.1, size=(60, 2))
    coil = hypothesis(0.4 * BOX + 0.6 * OTHER + noise, 4.0)
    assert drawn_along(coil, bodies)
    assert not drawn_along(replace(coil, size=np.full(60, 9.0)), bodies)
    assert not drawn_along(hypothesis(np.stack([60 + 5 * np.cos(0.9 * T), 0 * T], 1), 4.0), bodies)


def test_a_puck_that_another_strikes_is_a_body_and_the_mark_on_it_is_none() -> None:
    before, after = np.minimum(T - 30, 0), np.maximum(T - 30, 0)
    middle = np.array([60.0, 40.0])
    striking = middle + np.outer(before, [2.0, 0.3]) + np.outer(after, [-0.5, -0.8])
    struck = middle + [14, 6] + np.outer(before, [-0.5, 1.0]) + np.outer(after, [1.8, 0.6])
    larger = hypothesis(striking, 10.0)
    assert not drawn_along(hypothesis(struck, 6.0), [larger])
    off = 0.3 * (striking - striking.mean(0))[:, ::-1]  # it turns as the puck goes
    assert drawn_along(hypothesis(striking + off / np.abs(off).max() * 6, 3.0), [larger])
