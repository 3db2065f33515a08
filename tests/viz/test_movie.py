"""A film of an episode: as long and as large as told, and it moves."""

import cv2
import numpy as np
import pytest

from tests.viz.test_viz import make_showcase
from viz import movie
from viz.movie import write_movie

META = {"cell": "oracle/factored", "coupling": "0.8"}


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(movie, "SECONDS", 0.4)


@pytest.mark.parametrize("pictures", [True, False])
def test_a_film_is_written_whole_and_moves(tmp_path, pictures):
    write_movie(make_showcase(pictures), META, tmp_path / "out.mp4")
    film = cv2.VideoCapture(str(tmp_path / "out.mp4"))
    frames = []
    while (got := film.read())[0]:
        frames.append(got[1].astype(float))
    assert len(frames) == 10 and frames[0].shape == (720, 1280, 3)
    assert np.abs(frames[-1] - frames[0]).max() > 100
    assert [path.name for path in tmp_path.iterdir()] == ["out.mp4"]


def test_a_gif_and_a_still(tmp_path):
    from PIL import Image

    write_movie(make_showcase(), META, tmp_path / "out.gif")
    with Image.open(tmp_path / "out.gif") as gif:
        assert gif.n_frames == 5 and gif.size == (640, 360)
    write_movie(make_showcase(), META, tmp_path / "out.png")
    still = cv2.imread(str(tmp_path / "out.png"))
    assert still.shape == (720, 1280, 3) and len(np.unique(still)) > 50


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"ends in .mp4, .gif, .png, not in '.webm'"):
        write_movie(make_showcase(), META, tmp_path / "out.webm")
    assert not list(tmp_path.iterdir())
