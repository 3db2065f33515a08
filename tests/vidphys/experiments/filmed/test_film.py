"""Filmed clips: the truth lies where the picture shows it, and stays when a clip is made again."""

from dataclasses import replace

import numpy as np
import pytest

from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError
from vidphys.experiments.filmed import encode
from vidphys.experiments.filmed.camera import Lens, along
from vidphys.experiments.filmed.encode import write_h264
from vidphys.experiments.filmed.film import clip_of, compose, pictures, read_at, truth_of
from vidphys.experiments.filmed.folder import film_clip, film_folder
from vidphys.experiments.filmed.nuisances import PARTS, Nuisances, nuisances, part_of
from vidphys.experiments.filmed.props.bodies import body, extent
from vidphys.experiments.filmed.props.room import room
from vidphys.experiments.filmed.scenes.kinds import KINDS
from vidphys.experiments.filmed.scenes.scene import Course, Look
from vidphys.experiments.filmed.sensor import timing
from vidphys.experiments.filmed.studio import Studio, engine
from vidphys.experiments.filmed.truth import Truth


def can_draw():
    try:
        mujoco = engine()
        mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8).close()
    except Exception:
        return False
    return True


drawn = pytest.mark.skipif(not can_draw(), reason="MuJoCo cannot draw here: no EGL or OSMesa")
CLEAN = Nuisances(noise=0.0)


def scene(kind, seed=1):
    return KINDS[kind](np.random.default_rng(seed))


def short(kind, add, seed=1, seconds=0.4):
    """The first frames of a clip."""
    return compose(replace(scene(kind, seed), seconds=seconds), add, seed, 0, "mild")


def without(clip):
    """The same clip, its bodies far away."""
    return replace(clip, course=Course(clip.course.times, clip.course.places + 500.0))


@pytest.mark.parametrize("radial", [-0.25, -0.08, 0.0, 0.25])
@pytest.mark.parametrize("focal", [422.0, 512.0])
def test_each_pixel_looks_at_what_shows_there_also_in_a_strong_barrels_corners(radial, focal):
    lens = Lens.within(640, 360, focal, radial)
    rays = lens.rays()
    shown = np.stack(np.meshgrid(np.arange(640), np.arange(360)), -1)
    np.testing.assert_allclose(lens.project(rays), shown, atol=1e-6)
    assert np.linalg.norm(rays[..., :2], axis=-1).max() < 1.4  # a room, not the horizon
    assert lens.radial == radial or radial < lens.radial < -0.1


@drawn
@pytest.mark.parametrize(
    "add",
    [
        pytest.param(CLEAN, marks=pytest.mark.slow),
        pytest.param(replace(CLEAN, tilt=25.0, side=120.0, roll=4.0), marks=pytest.mark.slow),
        replace(CLEAN, radial=-0.2),
        replace(CLEAN, shake=0.5, readout=0.03, pan=3.0),
    ],
    ids=["still", "tilt", "lens", "rolling"],
)
def test_the_truth_lies_in_the_middle_of_the_ball_in_the_picture(add):
    # a small ball: perspective draws a large one a little off its centre
    small = replace(scene("toss"), seconds=0.4, looks=(Look("ball", 0.02),))
    clip = compose(small, add, 1, 0, "mild")
    truth = truth_of(clip)
    seen = list(pictures(clip, truth))
    empty = list(pictures(without(clip), truth))
    for k in (0, 5, len(seen) - 1):
        x, y = truth.pixels[k, 0]
        column, row = np.meshgrid(*(np.arange(n) for n in seen[k].shape[1::-1]))
        near = np.hypot(column - x, row - y) < 1.3 * radius_of(clip)
        differs = np.abs(seen[k].astype(int) - empty[k]).max(-1) > 6
        mask = near & differs
        assert mask.sum() > 0.85 * np.pi * radius_of(clip) ** 2
        assert column[mask].mean() == pytest.approx(x, abs=0.5)
        assert row[mask].mean() == pytest.approx(y, abs=0.5)


def radius_of(clip):
    """Of the first ball in the picture, pixels."""
    position, _ = clip.stand.poses(np.array(0.0))
    distance = np.linalg.norm(clip.view.world(clip.course.at(np.zeros((1, 1))))[0, 0] - position)
    return clip.lens.focal * clip.scene.looks[0].radius / distance


def test_a_camera_that_stays_has_the_same_truth_in_both_pictures():
    truth = truth_of(short("spring", replace(CLEAN, tilt=20.0)))
    assert truth.pixels == pytest.approx(truth.steady)
    moved = truth_of(short("spring", replace(CLEAN, pan=2.0)))
    assert np.abs(moved.pixels - moved.steady).max() > 2


def test_a_rolling_shutter_reads_a_high_body_before_a_low_one():
    clip = short("bounce", replace(CLEAN, readout=0.03))
    truth = truth_of(clip)
    rows = truth.pixels[..., 1] / (truth.size[0] - 1)
    late = read_at(clip, truth.times) - truth.times[:, None]
    assert late == pytest.approx((rows - 0.5) * 0.03, abs=1e-6)
    assert late[0, 0] < 0  # it falls from the top


def test_the_ruler_says_how_many_pixels_a_metre_has():
    clip = short("two masses", CLEAN)
    truth = truth_of(clip)
    scale = np.linalg.norm(np.diff(truth.ruler.pixels, axis=0)) / truth.ruler.metres
    metres = np.linalg.norm(truth.metres[0, 1] - truth.metres[0, 0])
    pixels = np.linalg.norm(truth.steady[0, 1] - truth.steady[0, 0])
    assert pixels / metres == pytest.approx(scale, rel=1e-3)


@pytest.mark.parametrize("number", range(40))
def test_everything_that_moves_stays_in_the_picture(number):
    clip = clip_of(3, number)
    height, width = clip.lens.height, clip.lens.width
    ends = clip.lens.project(along(clip.view.ruler, *clip.stand.poses(np.array(0.0))))
    for place in (*truth_of(clip).pixels.reshape(-1, 2), *ends):
        assert (place > 0).all()
        assert (place < [width, height]).all()


def test_every_other_clip_is_mild_and_each_strong_part_is_as_frequent():
    parts = [part_of(k) for k in range(200)]
    assert parts.count("mild") == 100
    assert {parts.count(part) for part in PARTS[1:6]} == {15}
    assert {parts.count(part) for part in PARTS[6:]} == {5}
    assert set(parts[:12]) == set(PARTS[:6])


@pytest.mark.parametrize("part", PARTS)
def test_a_part_has_its_own_trouble_and_no_other(part):
    add = nuisances(np.random.default_rng(0), part)
    told = {
        "tilt": "tilt",
        "shake": "shake",
        "lens": "radial",
        "clutter": "clutter",
        "exposure": "drift",
    }
    for name, value in told.items():
        strong = abs(float(getattr(add, value))) > {"tilt": 5, "shake": 0.1, "lens": 0.05}.get(
            name, 0.1
        )
        assert strong == (name == part)


def test_doubled_and_dropped_frames_are_known():
    random = np.random.default_rng(1)
    stamps, times, shown = timing(random, 4.0, Nuisances(doubled=0.2))
    twice = shown != np.arange(len(shown))
    assert 10 < twice.sum() < 40
    assert (times[twice] < stamps[twice]).all()
    assert times[~twice] == pytest.approx(stamps[~twice])
    stamps, times, _ = timing(random, 4.0, Nuisances(dropped=0.2, told=False))
    assert np.diff(stamps) == pytest.approx(1 / 30)
    assert 80 < len(times) < 110
    assert times[-1] > stamps[-1] + 0.2


def test_the_stamps_come_back_from_the_file(tmp_path):
    pytest.importorskip("av")
    stamps = np.cumsum([0.0, 1 / 30, 0.05, 1 / 30, 0.02, 0.1])
    frames = [np.full((48, 64, 3), 40 * k, np.uint8) for k in range(6)]
    write_h264(tmp_path / "a.mp4", frames, stamps, 30.0, 20)
    video = open_video(tmp_path / "a.mp4", ClipSelection())
    assert video.times == pytest.approx(stamps, abs=2e-3)
    assert [int(f.mean()) for f in video.frames] == pytest.approx([40 * k for k in range(6)], abs=4)


def test_without_the_encoder_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    with pytest.raises(InputError, match=r"pip install vidphys\[filmed\]"):
        encode.require_av()


def test_the_truth_is_read_as_it_was_written(tmp_path):
    truth = truth_of(short("pucks", CLEAN))
    truth.write(tmp_path / "truth.json")
    again = Truth.read(tmp_path / "truth.json")
    assert again.numbers == truth.numbers
    assert again.pixels == pytest.approx(truth.pixels, abs=1e-4)
    assert again.structure == ("collision",)


@drawn
@pytest.mark.parametrize("kind", ["pendulum hand", pytest.param("spring", marks=pytest.mark.slow)])
def test_drawing_only_where_something_moves_gives_the_whole_picture(kind, monkeypatch):
    clip = short(kind, replace(CLEAN, clutter=True), seconds=0.27)
    truth = truth_of(clip)
    parts = np.array(list(pictures(clip, truth)), int)
    monkeypatch.setattr(Studio, "_stir", lambda self: (0, 0, *self._size))
    whole = np.array(list(pictures(clip, truth)), int)
    assert (np.abs(parts - whole).max(-1) > 8).mean() < 1e-3


@drawn
def test_a_clip_that_is_there_is_not_filmed_again_and_the_index_lists_all(tmp_path, monkeypatch):
    pytest.importorskip("av")
    from vidphys.experiments.filmed import folder

    small = short("toss", CLEAN, seconds=0.3)
    monkeypatch.setattr(folder, "clip_of", lambda seed, number: replace(small, number=number))
    index = film_folder(tmp_path, 0, 2)
    assert '"clips/00001"' in index.read_text()
    monkeypatch.setattr(folder, "clip_of", lambda *_: pytest.fail("filmed again"))
    assert film_clip(tmp_path, 0, 1) == tmp_path / "clips" / "00001"
    video = open_video(tmp_path / "clips/00001/clip.mp4", ClipSelection())
    assert len(video.frames) == len(Truth.read(tmp_path / "clips/00001/truth.json").times)


def test_a_carts_wheels_are_parts_of_it():
    look = Look("cart", 0.05)
    frame, *wheels = body(look, "skin")
    for wheel in wheels:
        across, _, up = wheel.place
        assert np.hypot(across, up) + wheel.size[0] == pytest.approx(extent(look))
    assert np.hypot(frame.size[0], frame.size[2]) < extent(look)


@pytest.mark.parametrize("seed", range(40))
def test_no_two_things_at_a_wall_show_their_faces_in_one_place(seed):
    """They would flicker, as which of them is in front is decided by rounding."""
    flat = [p for p in room(np.random.default_rng(seed), 0.0, 0.6)[2:] if p.shape == "box"]
    for k, one in enumerate(flat):
        for other in flat[:k]:
            apart = np.abs(one.place - other.place) - one.size - other.size
            faces = np.subtract(one.place[1] - one.size[1], other.place[1] - other.size[1])
            assert apart[[0, 2]].max() > -1e-9 or np.abs(faces) > 1e-4
