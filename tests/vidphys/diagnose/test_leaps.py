"""What was found in a body's place, and what looks like it but is the body."""

from __future__ import annotations

import numpy as np
import pytest

from vidphys.diagnose.recordings.leaps import without_leaps

TIMES = np.arange(60) * 0.02


def swing(noise=0.0):
    path = np.stack([np.cos(3 * TIMES), 0.2 * np.sin(6 * TIMES)], -1)
    return (path + noise * np.random.default_rng(0).standard_normal(path.shape))[:, None]


def left_out(path):
    before = np.isfinite(path).all((1, 2))
    return np.flatnonzero(before & np.isnan(without_leaps(path, TIMES)).any((1, 2))).tolist()


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_what_stands_elsewhere_for_a_while_is_left_out(noise):
    path = swing(noise)
    path[20:29] = [2.0, 1.0]
    assert left_out(path) == list(range(20, 29))
    path[29:33] = np.nan  # and is lost before the body is found again
    assert left_out(path) == list(range(20, 29))
    path[16:20] = np.nan  # a leap to where it is lost, and from where it is
    path[29:33] = swing(noise)[29:33]
    assert left_out(path) == list(range(20, 29))


def test_a_body_itself_is_kept_however_it_moves():
    assert left_out(swing(0.003)) == []
    struck = np.where(TIMES < 0.4, 0.0, 8 * (TIMES - 0.4))
    assert left_out(np.stack([struck, 0 * struck], -1)[:, None]) == []
    bounced = np.abs(TIMES - 0.5)
    assert left_out(np.stack([TIMES, bounced], -1)[:, None]) == []
    dropped = np.delete(TIMES, [20, 22])  # frames that are missing without a stamp, one beside one
    assert (
        left_out(np.pad(np.stack([dropped, 0 * dropped], -1), ((0, 2), (0, 0)), "edge")[:, None])
        == []
    )
    path = swing()
    path[30:] += 2.0  # something else from here on: nothing tells which of the two is the body
    assert left_out(path) == []


def test_each_body_is_asked_alone():
    path = np.concatenate([swing(), swing() + 1], 1)
    path[10, 1] = 9.0
    kept = without_leaps(path, TIMES)
    assert np.isnan(kept[10, 1]).all() and np.isfinite(np.delete(kept, 10, 0)).all()
    assert np.isfinite(kept[:, 0]).all()
