"""Uneven frames read off at even times."""

import numpy as np
import pytest

from vidphys.diagnose.recordings.evened import evened
from vidphys.diagnose.recordings.motion import Motion, Unseen
from vidphys.diagnose.recordings.noise import measure_noise


def test_uneven_frames_are_read_at_even_times_and_gaps_stay():
    rng = np.random.default_rng(0)
    t = np.cumsum(0.1 * (1 + 0.3 * rng.uniform(-1, 1, 60)))
    t = np.delete(t, [30, 31, 32])
    q = np.stack([np.sin(t), np.cos(t)], -1)[None, :, None]
    q[0, 10] = np.nan
    even = evened(Motion(q, t[None], np.ones((1, 1))))
    gaps = np.diff(even.times[0])
    np.testing.assert_allclose(gaps, gaps[0])
    seen = even.seen[0, :, 0]
    exact = np.stack([np.sin(even.times[0]), np.cos(even.times[0])], -1)
    np.testing.assert_allclose(even.positions[0, seen, 0], exact[seen], atol=2e-4)
    lost = even.times[0, ~seen]
    assert ((lost > t[9]) & (lost < t[11]) | (lost > t[29]) & (lost < t[30])).all()
    assert len(lost) >= 3


def test_even_frames_stay_as_they_are():
    t = 0.04 * np.arange(30)
    q = np.random.default_rng(1).normal(size=(1, 30, 2, 2))
    even = evened(Motion(q, t[None], np.ones((1, 2))))
    np.testing.assert_allclose(even.positions, q, atol=1e-9)


def test_the_noise_of_frames_that_are_nowhere_even_is_measured():
    rng = np.random.default_rng(2)
    t = np.cumsum(0.1 * np.tile([1, 0.8, 1.25], 20))
    q = (np.sin(t) + rng.normal(0, 1e-2, len(t)))[None, :, None, None]
    noise = measure_noise(Motion(q, t[None], np.ones((1, 1))))
    assert 0.5e-2 < noise.sigma < 2e-2
    q[0, 1::2] = np.nan
    with pytest.raises(Unseen, match="no body is seen in 4"):
        measure_noise(Motion(q[:, :12], t[None, :12], np.ones((1, 1))))
