"""Pair forces by powers of the distance: the whole ones are told, those between leave a doubt."""

from __future__ import annotations

import pytest

from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.inference.doubts import doubts
from vidphys.experiments.confusion.storms.scenes import LISTED, filmed


def test_a_power_between_whole_ones_is_no_sure_trap_beside_a_whole_one():
    found = diagnose_motion(filmed(LISTED["power"], "white", 134).motion)
    assert found.inference is not None and found.explained
    assert found.kinds == {"pair", "trap"}  # of a pair force alone, which the menu lacks
    assert found.inference.between and not found.sure
    assert any("no whole number" in line for line in doubts(found.motion, found.inference))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["repulsion-trap", "gravity-drag"])
def test_a_whole_power_beside_another_force_stays_sure(name):
    found = diagnose_motion(filmed(LISTED[name], "white", 300).motion)
    assert found.inference is not None and not found.inference.between and found.sure
