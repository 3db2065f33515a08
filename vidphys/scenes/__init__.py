"""The systems of the study: each a law, a generator and its float64 truth."""

from collections.abc import Callable
from functools import partial

from registry import Registry
from vidphys.scenes.changed_laws import gravity_of_power, three_body_gravity
from vidphys.scenes.coulomb import coulomb, gravity_and_coulomb
from vidphys.scenes.crowd import crowd
from vidphys.scenes.drag import dragged, dragged_gravity
from vidphys.scenes.gravity import gravity
from vidphys.scenes.langevin import driven, langevin
from vidphys.scenes.lyapunov import lyapunov_time
from vidphys.scenes.many_terms import many_terms
from vidphys.scenes.oscillators import oscillators
from vidphys.scenes.pendulum import pendulum
from vidphys.scenes.scene import Certificate, Scene, certify
from vidphys.scenes.springs import springs
from vidphys.scenes.strikes import strikes
from vidphys.scenes.torus import disks

# Those that can be drawn and asked for by name, each made by a call without arguments.
SCENES: Registry[Callable[[], Scene]] = Registry("scene", "vidphys.scenes")
# a disk's picture does not show its mass
SCENES.register("gravity", partial(gravity, mass=(1.0, 1.0)))
SCENES.register("gravity-ring", partial(gravity, "ring", mass=(1.0, 1.0)))
SCENES.register("springs", springs)
SCENES.register("coulomb", coulomb)
SCENES.register("gravity-and-coulomb", gravity_and_coulomb)
SCENES.register("gravity-even", partial(gravity_of_power, "even"))
SCENES.register("gravity-quadratic", partial(gravity_of_power, "quadratic"))
SCENES.register("gravity-three-body", three_body_gravity)
SCENES.register("strikes", strikes)
SCENES.register("crowd", partial(crowd, 6))  # as many as there are colours
SCENES.register("drag-weak", partial(dragged_gravity, "weak"))
SCENES.register("drag-strong", partial(dragged_gravity, "strong"))
SCENES.register("many-terms", many_terms)
SCENES.register("langevin", langevin)
SCENES.register("driven", driven)
SCENES.register("disks-soft", partial(disks, "soft"))
SCENES.register("disks-stiff", partial(disks, "stiff"))
SCENES.register("disks-impulsive", partial(disks, "impulsive"))
SCENES.register("oscillators-coupled", partial(oscillators, "coupled"))
SCENES.register("oscillators-modified", partial(oscillators, "modified"))
SCENES.register("pendulum", pendulum)
SCENES.register("pendulum-linear", partial(pendulum, "linear"))
SCENES.register("pendulum-square", partial(pendulum, "square"))


def _dragged(name: str) -> Scene:
    return dragged(SCENES[name]())


# Baths and the pendulum have friction of their own; hard disks have no law that takes one.
for _name in (
    "gravity",
    "gravity-ring",
    "gravity-even",
    "gravity-quadratic",
    "gravity-three-body",
    "springs",
    "coulomb",
    "gravity-and-coulomb",
    "strikes",
    "crowd",
    "disks-soft",
    "disks-stiff",
    "oscillators-coupled",
    "oscillators-modified",
):
    SCENES.register(f"{_name}-dragged", partial(_dragged, _name))

__all__ = ["SCENES", "Certificate", "Scene", "certify", "gravity", "lyapunov_time"]
