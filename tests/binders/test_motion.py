"""The hand binder for real clips, on a clip drawn to have what real ones have."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from binders.base import MotionTracks
from binders.blobs import Blobs
from binders.camera import background_of, camera_drift, undo_drift
from binders.follow import Candidate, Path, path_of, ranked
from binders.hypotheses import hypotheses
from binders.lawful import judge
from binders.motion import MotionBinder
from binders.reel import Through

FRAMES, HEIGHT, WIDTH = 60, 96, 128
WALL = np.array([150.0, 130.0, 110.0])
DIM = 0.55 * WALL
COLOURS = np.array([[200.0, 40.0, 30.0], [30.0, 60.0, 200.0]])


def room(seed: int = 0) -> np.ndarray:
    """A wall with smooth shading and a few sharp still things, larger than the frame."""
    rng = np.random.default_rng(seed)
    shade = ndimage.gaussian_filter(rng.normal(size=(HEIGHT + 20, WIDTH + 20)), 8)
    wall = WALL * (1 + 2 * shade[..., None])
    for _ in range(6):
        y, x = rng.integers(5, HEIGHT), rng.integers(5, WIDTH)
        wall[y : y + 12, x : x + 3] *= 0.5
    return wall


def disc(centre: np.ndarray, radius: float) -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.clip(radius + 0.5 - np.hypot(x - centre[0], y - centre[1]), 0, 1)[..., None]


def draw(
    paths: np.ndarray, drift: np.ndarray, shade: float = 0.3, strings: bool = True
) -> np.ndarray:
    """Frames of discs on strings that cast shadows, by a camera that drifts; paths in pixels."""
    rng, wall = np.random.default_rng(1), room()
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    frames = []
    for bodies, move in zip(paths, drift, strict=True):
        shifted = ndimage.shift(wall, (move[1], move[0], 0), order=1, mode="nearest")
        image = shifted[10 : 10 + HEIGHT, 10 : 10 + WIDTH].copy()
        for centre, colour in zip(bodies + move, COLOURS, strict=False):
            image *= 1 - shade * disc(centre + (9, 4), 6)
            string = np.abs(x - centre[0]) * (y < centre[1]) + 99 * (y >= centre[1])
            image[(string < 1) & strings] = (230, 220, 200)
            body = disc(centre, 5.0)
            image = image * (1 - body) + colour * body
        frames.append(image + rng.normal(scale=1.5, size=image.shape))
    return np.clip(np.stack(frames), 0, 255).astype(np.uint8)


def swing() -> np.ndarray:
    """Swings out for the first third, then hangs nearly still: its place becomes a ghost."""
    t = np.arange(FRAMES)
    size = np.where(t < 20, 40.0, 3.0)
    return np.stack([70 - size * np.sin(0.35 * t) ** 2, 55 + 0.1 * size * np.cos(0.7 * t)], 1)


def still() -> np.ndarray:
    return np.zeros((FRAMES, 2))


def wobble() -> np.ndarray:
    t = np.arange(FRAMES) / FRAMES
    move = np.stack([3.5 * np.sin(5 * t), 2.5 * np.sin(8 * t + 1)], 1)
    return move - np.median(move, 0)


def pixels(found: MotionTracks) -> np.ndarray:
    normalised = found.tracks.positions[0].numpy()
    half = max(HEIGHT, WIDTH) / 2
    centre = np.array([WIDTH, HEIGHT]) / 2 - 0.5
    return normalised * half * [1, -1] + centre


def times() -> np.ndarray:
    return np.arange(FRAMES) / 30


@pytest.mark.parametrize(
    "drift", [pytest.param(still(), marks=pytest.mark.slow), wobble()], ids=["still", "hand-held"]
)
def test_follows_the_body_and_neither_shadow_nor_string(drift: np.ndarray) -> None:
    path = swing()[:, None]
    found = MotionBinder()(draw(path, drift), times())
    error = np.linalg.norm(pixels(found) - (path + drift[:, None]), axis=-1)
    assert np.sqrt((error**2).mean()) < 0.35
    assert error.max() < 1.0
    assert (found.tracks.confidence > 0.3).all()
    np.testing.assert_array_equal(found.tracks.times.numpy(), times())
    camera = found.camera.numpy() * [WIDTH / 2, -WIDTH / 2]
    assert np.abs(camera - (drift - drift[0])).max() < 0.3 and not camera[0].any()


def two_discs(light: float, grain: float, tint: float, colour: np.ndarray) -> np.ndarray:
    """A red disc that falls before boards, and another 30 pixels to its left that goes alike.

    Args:
        light: of the wall's, that is seen through the other.
        grain: of the boards, 0 where the wall is plain.
        tint: how much of the other is not seen through, but of a colour of its own.
        colour: which, RGB.
    """
    rng = np.random.default_rng(0)
    smooth = ndimage.gaussian_filter(rng.normal(size=(HEIGHT, WIDTH, 1)), (3, 1, 0))
    boards = 1.5 * smooth + 0.25 * (np.arange(HEIGHT) // 12 % 2)[:, None, None]
    wall, frames = DIM * (1 + grain * boards), []
    for t in range(FRAMES):
        place = np.array([80.0, 12 + 0.02 * t**2])
        beside, body = disc(place - (30, 0), 5.0), disc(place, 5.0)
        other = (1 - tint) * light * wall + tint * colour
        image = wall * (1 - beside) + other * beside
        image = image * (1 - body) + COLOURS[0] * body
        frames.append(image + rng.normal(scale=1.5, size=image.shape))
    return np.clip(np.stack(frames), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("clip", "bodies"),
    [
        (two_discs(0.45, 1.0, 0.0, DIM), 1),
        (two_discs(0.45, 1.0, 1.0, 0.45 * DIM), 2),
        pytest.param(two_discs(0.45, 0.0, 1.0, 0.45 * DIM), 2, marks=pytest.mark.slow),
        pytest.param(two_discs(0.45, 1.0, 0.1, COLOURS[1]), 2, marks=pytest.mark.slow),
        pytest.param(two_discs(2.2, 1.0, 0.0, DIM), 1, marks=pytest.mark.slow),
        pytest.param(two_discs(2.2, 1.0, 1.0, 2.2 * DIM), 2, marks=pytest.mark.slow),
    ],
    ids=["deep shadow", "as dark", "plain wall", "tinted", "more light", "as bright"],
)
def test_what_the_background_is_seen_through_in_other_light_is_no_body(clip, bodies) -> None:
    for binder, count in (
        (MotionBinder(bodies=None), bodies),
        (MotionBinder(bodies=None, shadow=1.0), 2),
    ):
        assert binder(clip, times()).tracks.positions.shape[2] == count


def test_what_hardly_leaves_its_place_is_cleaned_from_the_background_step_by_step() -> None:
    """What two looks leave of its ghost, at which it would be followed, a third one shows."""
    swung = np.cos(0.5 * np.arange(FRAMES))
    path = np.stack([56 + 4 * swung + 4 * np.maximum(swung, 0) ** 4, np.full(FRAMES, 50.0)], 1)
    found = MotionBinder()(draw(path[:, None], still()), times())
    error = np.linalg.norm(pixels(found)[:, 0] - path, axis=-1)
    assert np.sqrt((error**2).mean()) < 1.2


def test_a_body_is_not_lost_that_an_earlier_background_shows(monkeypatch) -> None:
    path = np.linspace((20, 40), (110, 60), FRAMES)[:, None]
    first = iter([True, True])  # with and without what a shadow explains

    def once(*seen):
        return hypotheses(*seen) if next(first, False) else []

    monkeypatch.setattr("binders.motion.hypotheses", once)
    for other_way in ("by_corners", "by_colour"):
        monkeypatch.setattr(f"binders.motion.{other_way}", lambda *_: [])
    error = np.linalg.norm(pixels(MotionBinder()(draw(path, still()), times())) - path, axis=-1)
    assert np.median(error) < 1.0


def test_two_bodies_keep_their_identity() -> None:
    t = np.arange(FRAMES) / FRAMES
    one = np.stack([15 + 95 * t, 30 + 12 * t], 1)
    two = np.stack([112 - 95 * t, 65 + 8 * np.sin(6 * t)], 1)
    paths = np.stack([one, two], 1)
    frames = draw(paths, still(), strings=False)
    bound = MotionBinder(bodies=2)(frames, times())
    assert bound.others == 0
    assert MotionBinder(bodies=1)(frames, times()).others > 0.8
    found = pixels(bound)
    error = min(
        np.abs(found - paths).max(),
        np.abs(found[:, ::-1] - paths).max(),
    )
    assert error < 1.5


@pytest.mark.slow
def test_grey_body_needs_brightness() -> None:
    frames = draw(swing()[:, None], still(), shade=0.0)
    grey = np.repeat(frames.mean(-1, keepdims=True), 3, -1).astype(np.uint8)
    for binder in (MotionBinder(shadow=1.0), MotionBinder()):
        error = np.linalg.norm(pixels(binder(grey, times()))[:, 0] - swing(), axis=-1)
        assert np.sqrt((error**2).mean()) < 1.0
    with pytest.raises(ValueError, match=r"keep changes of brightness \(shadow 1\)"):
        MotionBinder(shadow=0.6)(grey, times())


def test_refuses_what_it_cannot_follow() -> None:
    frames = draw(np.zeros((12, 0, 2)), still()[:12])
    with pytest.raises(ValueError, match="no frame shows 1 moving bodies"):
        MotionBinder()(frames, times()[:12])
    with pytest.raises(ValueError, match="at least 3 frames, got 2"):
        MotionBinder()(frames[:2], times()[:2])


def test_drift_needs_structure() -> None:
    """On a blank wall nothing tells where the camera is: then it is said to stand still."""
    rng = np.random.default_rng(0)
    blank = 120 + rng.normal(scale=1.0, size=(12, 64, 64)).astype(np.float32)
    assert np.abs(camera_drift(blank, list(range(12)))).max() < 0.3


def test_drift_looks_twice_at_a_frame_at_most() -> None:
    """At those of the sample in many rounds, and then at each."""
    frames = np.stack([ndimage.shift(room()[..., 0], (0, k % 3)) for k in range(12)])
    asked: list[float] = []
    grey = Through(frames, lambda frame: asked.append(frame.sum()) or frame.astype(np.float32))
    sample = list(range(0, 12, 2))
    drift = camera_drift(grey, sample)
    assert len(asked) <= len(sample) + len(frames)
    np.testing.assert_array_equal(drift, camera_drift(frames.astype(np.float32), sample))


def test_what_hides_most_of_the_edges_is_no_drift() -> None:
    """Somebody walks to and fro before the door, which is all that a bare wall has of edges."""
    rng, frames = np.random.default_rng(0), []
    for t in range(40):
        wall = np.full((90, 160), 170.0) + rng.normal(scale=1.0, size=(90, 160))
        wall[:, 60:62] = wall[:, 75:77] = 90
        wall[82:84] = 90
        if 12 <= t < 20:
            wall[:, 24 + 2 * t : 54 + 2 * t] = 60
        frames.append(wall)
    grey = np.array(frames, np.float32)
    assert np.abs(camera_drift(grey, list(range(0, 40, 2)))).max() < 1.0


@pytest.mark.slow
def test_somebody_who_is_there_all_the_time_is_no_drift() -> None:
    """Striped and close by, they have more edges than the shelf and the ruler behind them."""
    rng, frames = np.random.default_rng(0), []
    stripes = rng.uniform(20, 230, (120, 14)).repeat(6, 1)
    for t in range(60):
        wall = np.full((120, 180), 170.0) + rng.normal(scale=1.0, size=(120, 180))
        wall[::8, 160:166] = wall[104:107] = wall[20:100, 12:15] = 90
        left = round(48 + 30 * np.sin(t / 7))
        wall[:100, left : left + 84] = stripes[:100]
        frames.append(wall)
    grey = np.array(frames, np.float32)
    assert np.abs(camera_drift(grey, list(range(0, 60, 2)))).max() < 1.0


def test_drift_is_undone() -> None:
    image = room()[:HEIGHT, :WIDTH].astype(np.float32)
    moved = ndimage.shift(image, (2, -3, 0), order=1, mode="nearest")
    back = undo_drift(moved, np.array([-3.0, 2.0]))
    np.testing.assert_allclose(back[5:-5, 5:-5], image[5:-5, 5:-5], atol=1e-3)


@pytest.mark.slow
def test_a_camera_that_rolls() -> None:
    """A hand turns it about its axis by a degree: the far ends of the picture move by pixels."""
    path, roll = swing(), np.radians(1.0) * np.sin(np.arange(FRAMES) / 5)
    drift = np.stack([*wobble().T, roll], 1)
    steady = draw(path[:, None], still(), strings=False)
    moved = [undo_drift(f, -d) for f, d in zip(steady.astype(np.float32), drift, strict=True)]
    frames = np.rint(moved).astype(np.uint8)
    found = camera_drift(frames.mean(-1).astype(np.float32), list(range(0, FRAMES, 2)))
    off = found[:, 2] - roll
    assert np.abs(off - np.median(off)).max() < 2e-3
    bound = MotionBinder(shadow=0.6)(frames, times())
    camera = bound.camera.numpy()[:, None] * [WIDTH / 2, -WIDTH / 2]
    places = pixels(bound) - camera - path[:, None]
    assert np.abs(places - np.median(places, 0)).max() < 1.0


def test_background_without_the_ghost() -> None:
    images = np.full((9, 2, 2, 3), 100.0, np.float32)
    images[:6, 0, 0] = 200  # a body that is there most of the time
    images[:, 1, 1] = 7  # always hidden: nothing better is known
    hidden = np.zeros((9, 2, 2), bool)
    hidden[:6, 0, 0] = hidden[:, 1, 1] = True
    assert background_of(images)[0, 0, 0] == 200
    found = background_of(images, hidden)
    assert found[0, 0, 0] == 100 and found[1, 1, 0] == 7


def blobs(*centres: tuple[float, float], energy: tuple[float, ...] = (100.0,)) -> Blobs:
    count = len(centres)
    same, colour = np.full(count, 2.0), np.zeros((count, 3))
    strong = np.resize(np.array(energy), count)
    where = np.array(centres, float).reshape(count, 2)
    return Blobs(where, strong, same, same, colour, np.ones(count), np.zeros(count))


def one(x: float, energy: float = 100.0) -> Blobs:
    return blobs((x, 0.0), energy=(energy,))


def none() -> Blobs:
    return blobs()


def follow(seen: list[Blobs], bodies: int) -> Path:
    steps = np.arange(float(len(seen)))
    found = hypotheses(seen, steps)
    judged = judge(found, steps, 100.0, [1.0] * len(found))
    likeliest = ranked([Candidate(h, j, 0) for h, j in zip(found, judged, strict=True)])
    return path_of(seen, [each.body for each in likeliest[:bodies]])


def test_gaps_are_interpolated_without_confidence() -> None:
    path = follow([one(0), one(3), none(), none(), one(12), one(15)], 1)
    np.testing.assert_allclose(path.positions[:, 0, 0], [0, 3, 6, 9, 12, 15])
    np.testing.assert_array_equal(path.confidence[:, 0], [1, 1, 0, 0, 1, 1])


def test_a_faint_or_far_blob_is_not_the_body() -> None:
    path = follow([one(0), one(3), one(6, energy=2.0), one(500), one(12)], 1)
    np.testing.assert_array_equal(path.confidence[:, 0], [1, 1, 0, 0, 1])


def test_a_body_that_is_lost_does_not_become_another() -> None:
    """However long it is not seen, it comes back where it can have got to."""
    gone = [none()] * 12
    slow = [one(x) for x in (0, 1, 2, 3, 4)]
    path = follow([*slow, *gone, *[one(80)] * 3], 1)
    np.testing.assert_array_equal(path.confidence[:5, 0], 1)
    np.testing.assert_array_equal(path.confidence[5:, 0], 0)
    path = follow([*slow, *gone, one(17), one(18), one(19), one(20)], 1)
    np.testing.assert_array_equal(path.confidence[-4:, 0], 1)


def test_what_is_strong_for_a_while_is_not_what_is_there_all_the_time() -> None:
    def both(x: float) -> Blobs:
        return blobs((x, 0.0), (300.0, 0.0), energy=(100.0, 400.0))

    path = follow([one(x) if x < 30 else both(x) for x in range(40)], 1)
    np.testing.assert_array_equal(path.positions[:, 0, 0], range(40))
    assert path.others == 0.25


def test_a_hand_that_reaches_into_the_picture_is_no_body() -> None:
    """Its middle is not in the picture; it threw the body up and is drawn back."""
    t = np.arange(FRAMES)
    ball = np.stack([60 + 0.2 * t, 25 + 0.06 * (t - 30.0) ** 2], 1)
    frames = draw(ball[:, None], still(), shade=0, strings=False)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for frame, when in zip(frames, t, strict=True):
        frame[(np.abs(x - 100) < 8) & (y > HEIGHT - 40 + 2 * when)] = (90, 160, 60)
    found = MotionBinder()(frames, times())
    error = np.linalg.norm(pixels(found)[:, 0] - ball, axis=-1)
    assert (found.tracks.confidence > 0.3).all() and error.max() < 1.0
    assert found.others == 0


def test_a_body_that_the_edge_cuts_is_not_seen() -> None:
    t = np.arange(FRAMES)
    path = np.stack([-10 + 3.0 * t, 30 + 0 * t], 1)
    found = MotionBinder()(draw(path[:, None], still(), 0, False), times())
    seen = found.tracks.confidence[0, :, 0].numpy() > 0
    whole = (path[:, 0] > 5) & (path[:, 0] < WIDTH - 6)
    assert (seen == whole).mean() > 0.95 and not seen[~whole & (path[:, 0] < 3)].any()
    assert np.abs(pixels(found)[seen, 0, 0] - path[seen, 0]).max() < 1.0


def test_a_bounce_is_followed() -> None:
    x = [0, 6, 12, 18, 12, 6, 0]
    path = follow([one(v) for v in x], 1)
    np.testing.assert_allclose(path.positions[:, 0, 0], x)


def test_crossing_bodies_go_on_as_they_went() -> None:
    seen = []
    for t in range(9):
        centres = [(4.0 * t, 3.0), (32 - 4.0 * t, -3.0)]
        seen.append(blobs(*(centres if t % 2 else centres[::-1]), energy=(100.0, 99.0)))
    path = follow(seen, 2)
    first = path.positions[:, 0, 1]
    assert abs(first).min() == 3 and len(set(first)) == 1
