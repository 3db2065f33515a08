"""Tables as motions to diagnose, and what is said of those that are none."""

import numpy as np
import pytest

from vidphys.diagnose.recordings.tables import read_tracks
from vidphys.errors import InputError

T = np.arange(40) * 0.04


def test_a_table_whose_times_are_not_told_says_how_it_was_read(tmp_path):
    table = tmp_path / "angles.txt"
    table.write_text("".join(f"{np.cos(t):.6f},{t:.3f},{np.sin(3 * t):.6f}\n" for t in T))
    with pytest.raises(InputError, match=r"taken for x, y, z \(y rises as times do\)") as caught:
        read_tracks(table)
    assert "`columns` time=NAME" in str(caught.value) and "\n" not in str(caught.value)
    loaded = read_tracks(table, {"time": "y", "angle[deg]": "x"})
    assert loaded.angles
    np.testing.assert_allclose(loaded.motion.times[0], T, atol=1e-9)
    np.testing.assert_allclose(
        loaded.motion.positions[0, :, 0, 0], np.radians(np.cos(T)), atol=1e-6
    )
