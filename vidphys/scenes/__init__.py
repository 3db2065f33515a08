"""The systems of the study: each a law, a generator and its float64 truth."""

from collections.abc import Callable
from functools import partial

from registry import Registry
from vidphys.scenes.coulomb import coulomb, gravity_and_coulomb
from vidphys.scenes.gravity import gravity
from vidphys.scenes.lyapunov import lyapunov_time
from vidphys.scenes.scene import Certificate, Scene, certify
from vidphys.scenes.springs import springs

# Those that can be drawn and asked for by name, each made by a call without arguments.
SCENES: Registry[Callable[[], Scene]] = Registry("scene", "vidphys.scenes")
# a disk's picture does not show its mass
SCENES.register("gravity", partial(gravity, mass=(1.0, 1.0)))
SCENES.register("gravity-ring", partial(gravity, "ring", mass=(1.0, 1.0)))
SCENES.register("springs", springs)
SCENES.register("coulomb", coulomb)
SCENES.register("gravity-and-coulomb", gravity_and_coulomb)

__all__ = ["SCENES", "Certificate", "Scene", "certify", "gravity", "lyapunov_time"]
