"""A body's place where part of it does not stand out, or where something is at it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from binders.exchanged import apart, told_apart
from binders.exposure import evenly_lit
from binders.hypotheses import Hypothesis
from binders.lookalike import seen_again
from binders.motion import MotionBinder
from binders.placed import _mended, placed
from binders.reel import filled

FRAMES, SIDE, RADIUS = 60, 96, 7.0
Y, X = np.mgrid[:SIDE, :SIDE]
GREEN, GREY, RED = (40, 160, 60), (90, 85, 80), (220, 60, 40)


def swing() -> np.ndarray:
    angle = 0.7 * np.cos(0.3 * np.arange(FRAMES))
    return np.stack([48 + 60 * np.sin(angle), 10 + 60 * np.cos(angle)], 1)


def drawn(path: np.ndarray, rod: float) -> np.ndarray:
    rng, frames = np.random.default_rng(0), []
    for x, y in path:
        shade = 185 + 10 * np.sin(X / 5) * np.cos(Y / 7)
        image = np.repeat(shade[..., None], 3, 2)
        along = np.clip(((X - 48) * (x - 48) + (Y - 10) * (y - 10)) / 60**2, 0, 1)
        image[np.hypot(X - 48 - along * (x - 48), Y - 10 - along * (y - 10)) < rod] = GREY
        inside = np.clip(RADIUS + 0.5 - np.hypot(X - x, Y - y), 0, 1)[..., None]
        image = image * (1 - inside) + np.array(GREEN) * inside
        frames.append(image + rng.normal(scale=1.5, size=image.shape))
    return np.clip(np.stack(frames), 0, 255).astype(np.uint8)


def worst(frames: np.ndarray, path: np.ndarray) -> float:
    found = MotionBinder(bodies=1)(frames, np.arange(FRAMES) / 30).tracks.positions[0, :, 0].numpy()
    return float(np.abs(found * SIDE / 2 * [1, -1] + SIDE / 2 - 0.5 - path).max())


def test_the_rod_of_a_pendulum_is_no_part_of_its_weight() -> None:
    path = swing()
    assert worst(drawn(path, rod=2.5), path) < 1.0


def test_half_of_a_body_is_not_where_it_is() -> None:
    path, t = swing(), np.arange(FRAMES)
    half = np.where(t % 4 == 0, -3.5, 0) + np.where(t % 4 == 1, 3.5, 0)
    seen = path + np.stack([0 * half, half], 1)  # by what stands out of it
    changed = np.hypot(X - path[:, 0, None, None], Y - path[:, 1, None, None]) < RADIUS
    changed &= np.abs(Y - path[:, 1, None, None]) > 1.0
    ones, size = np.ones(FRAMES), np.full(FRAMES, 5.0)
    blobs = Hypothesis(seen, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    found = placed(blobs, drawn(path, rod=0.0), changed, t.astype(float))
    assert np.abs(found.positions - path).max() < 0.7


def test_a_body_that_shows_another_side_is_not_where_its_picture_was() -> None:
    """As a bowl that falls by, seen from below first: its dark side goes over it."""
    path, t = swing(), np.arange(FRAMES)
    frames, away = drawn(path, rod=0.0), Y - path[:, 1, None, None]
    seen = path + np.random.default_rng(1).normal(scale=1.0, size=path.shape)
    changed = np.hypot(X - seen[:, 0, None, None], Y - seen[:, 1, None, None]) < RADIUS
    inside = np.hypot(X - path[:, 0, None, None], away) < RADIUS
    frames[inside & (away > np.linspace(-RADIUS, RADIUS, FRAMES)[:, None, None])] = GREY
    ones, size = np.ones(FRAMES), np.full(FRAMES, RADIUS)

    def shift(turned: float) -> float:
        """How far it goes over the body, by its looks."""
        shade = turned * (t / FRAMES)[:, None] * np.array([1.0, -1.0, 1.0])
        blobs = Hypothesis(seen, ones, size, size, shade, ones, 0 * ones)
        off = (placed(blobs, frames, changed, t.astype(float)).positions - path)[:, 1]
        return abs(float(off[:20].mean() - off[-20:].mean()))

    assert shift(4.0) < 0.5 * shift(0.0)


def test_the_mark_of_a_puck_that_turns_does_not_draw_its_place_along() -> None:
    t, rng = np.arange(FRAMES), np.random.default_rng(1)
    path, turned = np.stack([14 + 1.1 * t, 30 + 0.6 * t], 1), 0.03 * t
    seen = path + rng.normal(scale=0.3, size=path.shape)
    frames = drawn(path, rod=0.0)
    for image, (x, y), angle in zip(frames, path, turned, strict=True):
        along = (X - x) * np.cos(angle) + (Y - y) * np.sin(angle)
        image[(along > 0) & (np.hypot(X - x, Y - y) < RADIUS - 1)] = RED
    changed = np.hypot(X - seen[:, 0, None, None], Y - seen[:, 1, None, None]) < RADIUS
    ones, size = np.ones(FRAMES), np.full(FRAMES, RADIUS)
    blobs = Hypothesis(seen, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    mark = path + 4 * np.stack([np.cos(turned), np.sin(turned)], 1)
    for found in (blobs, replace(blobs, positions=mark, cornered=True)):
        off = placed(found, frames, changed, t.astype(float)).positions - path
        assert np.abs(off[:15].mean(0) - off[-15:].mean(0)).max() < 0.3


def test_nor_does_it_where_the_puck_is_looked_for_by_its_looks() -> None:
    t = np.arange(FRAMES)
    path = np.stack([30 + 0.3 * t, 40 + 0.2 * t], 1)
    frames = drawn(path, rod=0.0)
    for k, (x, y) in enumerate(path):
        mark = x + 4 * np.cos(0.06 * k), y + 4 * np.sin(0.06 * k)
        frames[k][np.hypot(X - mark[0], Y - mark[1]) < 2.5] = 250
    changed = np.hypot(X - path[:, 0, None, None], Y - path[:, 1, None, None]) < RADIUS
    late, ones, size = t[:, None] >= 40, np.ones(FRAMES), np.full(FRAMES, RADIUS)
    known = np.where(late, path, np.nan)
    blobs = Hypothesis(known, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    found = seen_again(blobs, frames, changed)
    assert np.abs(found.positions - path).max() < 0.7


@pytest.mark.parametrize("ahead", [6, 60])
def test_a_body_may_be_placed_outside_the_picture(ahead) -> None:
    path = np.stack([3.0 * np.arange(FRAMES) - ahead, np.full(FRAMES, 40.0)], 1)
    path = path[path[:, 0] < X.max()]
    frames = drawn(path, rod=0.0)
    changed = np.hypot(X - path[:, 0, None, None], Y - path[:, 1, None, None]) < RADIUS
    ones, size = np.ones(len(path)), np.full(len(path), RADIUS)
    body = Hypothesis(path, ones, size, size, np.zeros((len(path), 3)), ones, 0 * ones)
    missed = replace(body, positions=np.where(np.arange(len(path))[:, None] % 5 == 4, np.nan, path))
    found = seen_again(missed, frames, changed).positions
    whole = (path[:, 0] > 2 * RADIUS) & (path[:, 0] < X.max() - 2 * RADIUS)
    assert np.abs(found - path)[whole].max() < 0.7


def test_a_ball_stays_where_it_is_while_the_exposure_drifts() -> None:
    """Lit from above, it looks in the dark as its lower half does in the light."""
    path, t = swing(), np.arange(FRAMES)
    seen = path + np.random.default_rng(1).normal(scale=1.0, size=path.shape)
    away = Y - path[:, 1, None, None]
    inside = np.hypot(X - path[:, 0, None, None], away) < RADIUS
    lit = (
        np.where(inside, 1 - 0.5 * away / RADIUS, 1.0)
        * np.linspace(0.4, 1.0, FRAMES)[:, None, None]
    )
    frames = np.clip(drawn(path, rod=0.0) * lit[..., None], 0, 255).astype(np.uint8)
    changed = np.hypot(X - seen[:, 0, None, None], Y - seen[:, 1, None, None]) < RADIUS
    ones, size = np.ones(FRAMES), np.full(FRAMES, RADIUS)
    blobs = Hypothesis(seen, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    lit_evenly = evenly_lit(filled(frames), list(range(0, FRAMES, 4)))
    found = placed(blobs, lit_evenly, changed, t.astype(float))
    assert np.abs(found.positions - path).max() < 0.5


def test_frames_are_as_bright_as_usual_before_they_are_looked_at() -> None:
    """As a phone sets it, of each channel its own; what moves says nothing of it."""
    frames, t = drawn(swing(), rod=0.0), np.arange(FRAMES)
    light = np.exp(0.3 * np.sin(0.1 * t)[:, None] * [1.0, 0.7, 0.4])[:, None, None]
    dark = filled(np.clip(0.6 * frames * light, 0, 255).astype(np.uint8))
    even = np.stack(list(evenly_lit(dark, list(range(0, FRAMES, 4)))))
    usual = np.median(even, 0)
    assert np.abs(np.median(even / usual, (1, 2)) - 1).max() < 0.01
    steady = filled(frames)
    assert evenly_lit(steady, [0, 20, 40]) is steady


def test_what_fills_much_of_the_picture_is_no_exposure() -> None:
    frames = drawn(swing(), rod=0.0)
    hand = np.random.default_rng(0).uniform(20, 130, (SIDE, SIDE, 3))
    for k in range(40, 46):
        frames[k, :, : 6 * SIDE // 10] = hand[:, : 6 * SIDE // 10]
    even = evenly_lit(filled(frames), list(range(0, FRAMES, 4)))
    assert np.abs(np.stack(list(even)).astype(float) - frames).max() <= 3


def test_a_body_that_a_post_half_hides_is_not_in_the_middle_of_what_it_leaves() -> None:
    path, t = swing(), np.arange(FRAMES)
    frames, post = drawn(path, rod=0.0), np.abs(X - 76) < 6
    frames[:, post] = (255, 0, 255)  # as unlike the body as can be: its picture shuns it
    shown = np.hypot(X - path[:, 0, None, None], Y - path[:, 1, None, None]) < RADIUS
    shown &= ~post
    left = shown & (X < 76)
    shown = np.where((left.sum((1, 2)) > 40)[:, None, None], left, shown)  # the larger part
    area = shown.sum((1, 2))
    middle = np.stack([(shown * X).sum((1, 2)), (shown * Y).sum((1, 2))], 1) / area[:, None]
    assert np.abs(middle - path).max() > 3  # or this shows nothing
    ones, size = np.ones(FRAMES), np.sqrt(area / np.pi)
    blobs = Hypothesis(middle, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    off = np.abs(placed(blobs, frames, shown, t.astype(float)).positions - path).max(1)
    assert np.nanmax(off) < 1.0
    assert np.isfinite(off).mean() > 0.7


def test_what_draws_one_way_along_for_a_while_is_outvoted() -> None:
    """As corners of what passes by do: smoothly, so that it looks lawful."""
    path, t = swing(), np.arange(FRAMES)
    seen = path + np.stack([4 * np.exp(-(((t - 30) / 4.0) ** 2)), 0 * t], 1)
    ones, size = np.ones(FRAMES), np.full(FRAMES, RADIUS)
    blobs = Hypothesis(seen, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    outline, picture = (
        path + np.random.default_rng(k).normal(scale=0.3, size=path.shape) for k in (0, 1)
    )
    _, mended, _ = _mended(blobs, [outline, seen, picture], ones)
    assert np.abs(mended - path).max() < 2


def test_corners_of_a_turning_body_with_a_board_behind_it_are_not_its_middle() -> None:
    """They move along the board's edge, smoothly, while the weight goes up and down."""
    angle, t = 1.2 * np.cos(0.15 * np.arange(FRAMES)), np.arange(FRAMES)
    path = np.stack([48 + 35 * np.sin(angle), 32 + 35 * np.cos(angle)], 1)
    seen = np.stack([path[:, 0], np.full(FRAMES, 58.0)], 1)
    drawn_at = path + np.random.default_rng(1).normal(scale=0.2, size=path.shape)
    changed = np.hypot(X - drawn_at[:, 0, None, None], Y - drawn_at[:, 1, None, None]) < RADIUS
    ones, size = np.ones(FRAMES), np.full(FRAMES, RADIUS)
    turned = (t / 10)[:, None] * np.ones(3)  # its looks: no picture tells its place
    corners = Hypothesis(seen, ones, size, size, turned, ones, 0 * ones, cornered=True)
    found = placed(corners, drawn(path, rod=0.0), changed, t.astype(float)).positions
    assert np.abs(found - path).max() < 4 < 10 < np.abs(seen - path).max()


def test_what_is_seen_in_parts_alone_keeps_its_places() -> None:
    ones, size = np.ones(FRAMES), np.full(FRAMES, RADIUS)
    size[::3] = 4.0
    seen = np.where((size < RADIUS)[:, None], swing(), np.nan)  # the rest is another body's
    blobs = Hypothesis(seen, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    for way in _mended(blobs, [seen, seen, seen], ones):
        np.testing.assert_array_equal(way, seen)


def body(x: np.ndarray, size: np.ndarray) -> Hypothesis:
    ones = np.ones(len(x))
    places = np.stack([x, 0 * x], 1)
    return Hypothesis(places, ones, size, size, np.zeros((len(x), 3)), ones, 0 * ones)


def test_what_two_share_is_the_one_that_looks_so_elsewhere() -> None:
    t = np.arange(40.0)
    small, large = np.full(40, 6.0), np.full(40, 9.0)
    left, right = 2 * t, np.full(40, 200.0)
    # struck, the large one goes on as the small one came: followed as one, and the likelier
    both = body(np.where(t < 20, left, right), np.where(t < 20, small, large))
    one, other = apart([both, body(left, small)])
    assert not one.seen[:20].any() and one.seen[22:].all()
    assert other.seen.all()
    one, other = apart([body(left, small), body(left, small)])  # nothing tells them apart
    assert one.seen.all() and not other.seen.any()


def test_bodies_that_were_exchanged_where_they_met_are_told_by_their_size() -> None:
    t = np.arange(40.0)
    left, right = np.minimum(2 * t, 38), np.maximum(80 - 2 * t, 42)  # they meet and stay there
    small, large = np.full(40, 6.0), np.full(40, 9.0)
    left, right = left - np.maximum(0, t - 20), right + np.maximum(0, t - 20) * 2
    one = body(left, np.where(t < 20, small, large))
    other = body(right, np.where(t < 20, large, small))
    first, second = told_apart([one, other])
    assert (first.size != 6).sum() <= 1 and (second.size != 9).sum() <= 1  # as they touch
    kept = told_apart([first, second])
    np.testing.assert_array_equal(kept[0].positions, first.positions)


def test_what_stands_out_of_a_body_only_before_a_board_is_not_the_body() -> None:
    """The middle of its lower part keeps to the board, which looks lawful: it goes to and fro."""
    path, t = swing(), np.arange(FRAMES)
    seen = np.stack([path[:, 0], np.full(FRAMES, path[:, 1].mean())], 1)
    changed = np.hypot(X - path[:, 0, None, None], Y - path[:, 1, None, None]) < RADIUS
    ones, size = np.ones(FRAMES), np.full(FRAMES, 5.0)
    blobs = Hypothesis(seen, ones, size, size, np.zeros((FRAMES, 3)), ones, 0 * ones)
    found = placed(blobs, drawn(path, rod=0.0), changed, t.astype(float))
    off = found.positions - path
    assert np.abs(off - np.median(off, 0)).max() < 0.7
