"""Of bodies that act on each other, laws of each are asked only where they may be those."""

import numpy as np
import pytest

from tests.vidphys.diagnose.test_encounters import INTERVAL, NOISE
from vidphys.diagnose.explanations import choice
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

T = np.arange(400) * INTERVAL
FIRST = np.array([1.0, 0.2])  # the way that both move along, where they move along one


def on_springs(across: float) -> np.ndarray:
    """Two bodies that springs hold to one place and to each other, ``(1, t, 2, 2)``."""
    aside = np.array([-0.2, 1.0]) * across
    both = np.cos(1.4 * T)[:, None] * FIRST + np.sin(1.4 * T)[:, None] * aside
    apart = 0.4 * (np.sin(3.7 * T)[:, None] * FIRST + np.cos(3.7 * T)[:, None] * aside)
    noise = NOISE * np.random.default_rng(1).standard_normal((len(T), 2, 2))
    return (np.stack([both + apart, both - apart], 1) + noise)[None]


@pytest.mark.parametrize(("across", "asked"), [(0.5, 0), (0.02, 1)])
def test_laws_of_each_are_asked_only_of_bodies_that_move_to_and_fro(monkeypatch, across, asked):
    made = []
    monkeypatch.setattr(choice, "FITTED", (lambda *given: made.append(given),))
    given = answer(motion_of(on_springs(across), INTERVAL), False, 0.3)
    assert len(made) == asked
    if not asked:
        assert given.data["status"] == "mostly explained"  # another force is as likely
        assert given.data["terms"] == ["pair", "trap"]


def test_thinned_frames_are_still_those_in_which_each_body_was_seen():
    path = on_springs(0.5)
    path[0, [3, 6, 7, 12], 1] = np.nan
    thin = frames_of(motion_of(path, INTERVAL))[0].thinned(3)
    np.testing.assert_array_equal(thin.times, T[::3])
    assert [len(seen) for seen in thin.seen] == [134, 131]
    for body, (seen, stretch) in enumerate(zip(thin.seen, thin.stretches, strict=True)):
        np.testing.assert_array_equal(stretch.times, thin.times[seen])
        np.testing.assert_array_equal(stretch.places, path[0, 3 * seen, body])
