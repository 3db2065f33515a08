"""All kinds of filmed scenes by name, and the terms that a right answer names for each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vidphys.experiments.filmed.scenes import flying, swinging
from vidphys.experiments.filmed.scenes.scene import Scene

KINDS: dict[str, Callable[[np.random.Generator], Scene]] = {
    "pendulum string": swinging.pendulum_string,
    "bounce": flying.bounce,
    "spring": swinging.spring,
    "toss": flying.toss,
    "pendulum rod": swinging.pendulum_rod,
    "pucks": flying.pucks,
    "two pendulums": swinging.two_pendulums,
    "fall": flying.fall,
    "pendulum hand": swinging.pendulum_hand,
    "incline": flying.incline,
    "double pendulum": swinging.double_pendulum,
    "toss hand": flying.toss_hand,
    "hanging spring": swinging.hanging_spring,
    "drop hand": flying.drop_hand,
    "coupled pendulums": swinging.coupled_pendulums,
    "roll": flying.roll,
    "pendulum air": swinging.pendulum_air,
    "two masses": swinging.two_masses,
}

# By the kinds of `vidphys.diagnose`: the one place that says what an exact answer is.
STRUCTURES: dict[str, frozenset[str]] = {
    "pendulum string": frozenset({"pendulum", "linear"}),
    "pendulum rod": frozenset({"pendulum", "linear"}),
    "pendulum hand": frozenset({"pendulum", "linear"}),
    "pendulum air": frozenset({"pendulum", "square"}),
    "two pendulums": frozenset({"pendulum", "linear"}),
    "coupled pendulums": frozenset({"pendulum", "linear", "spring"}),
    "double pendulum": frozenset({"double pendulum"}),
    "spring": frozenset({"trap", "linear"}),
    "hanging spring": frozenset({"trap", "linear"}),
    "two masses": frozenset({"trap", "linear", "spring"}),
    "toss": frozenset({"uniform"}),
    "toss hand": frozenset({"uniform"}),
    "bounce": frozenset({"uniform", "wall"}),
    "drop hand": frozenset({"uniform", "wall"}),
    "incline": frozenset({"uniform"}),
    "roll": frozenset({"dry"}),
    "fall": frozenset({"uniform", "square"}),
    "pucks": frozenset({"collision"}),
}
