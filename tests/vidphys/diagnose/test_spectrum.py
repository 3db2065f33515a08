"""What a sine explains, over many frequencies at once."""

import numpy as np
import pytest

from vidphys.diagnose.weak.spectrum import AT_ONCE, _explained, modes_of_data


@pytest.mark.parametrize("count", [1, AT_ONCE, AT_ONCE + 3])
def test_a_sine_explains_what_least_squares_say(count):
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 10, 80))
    x = rng.standard_normal((80, 3))
    trial = 2.0 + 0.31 * np.arange(count)
    found = _explained(t, x, trial)
    for w, explained in zip(trial, found, strict=True):
        basis = np.stack([np.cos(w * t), np.sin(w * t)], -1)
        fitted = basis @ np.linalg.lstsq(basis, x, rcond=None)[0]
        assert explained == pytest.approx((x**2).sum() - ((x - fitted) ** 2).sum(), rel=1e-9)


@pytest.mark.parametrize("frames", [40, 41])
def test_nothing_is_explained_at_the_limit_of_the_frames(frames):
    t = 0.1 * np.arange(frames)
    x = np.cos(7 * t)[:, None]
    found = _explained(t, x - x.mean(), np.linspace(1, np.pi / 0.1, 300))
    assert found[-1] == 0.0 and found.max() <= ((x - x.mean()) ** 2).sum()
    assert np.linspace(1, np.pi / 0.1, 300)[found.argmax()] == pytest.approx(7, abs=0.1)


def test_two_swings_are_found_with_their_decays():
    t = np.arange(600) * 0.03
    both = np.exp(-0.1 * t) * np.cos(5 * t) + 0.5 * np.exp(-0.05 * t) * np.sin(2.1 * t)
    slow, fast = modes_of_data(t, both[:, None, None], 2)
    assert (slow.frequency, fast.frequency) == pytest.approx((2.1, 5.0), rel=2e-3)
    assert (slow.decay, fast.decay) == pytest.approx((0.05, 0.1), abs=0.01)
