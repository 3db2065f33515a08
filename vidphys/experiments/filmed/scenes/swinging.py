"""Pendulums and springs."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.laws.law import GRAVITY
from vidphys.experiments.filmed.laws.pendulums import (
    COUPLED_PENDULUMS,
    DOUBLE_PENDULUM,
    PENDULUM,
    TWO_PENDULUMS,
)
from vidphys.experiments.filmed.laws.springs import SPRING, TWO_MASSES
from vidphys.experiments.filmed.scenes.scene import (
    Fixture,
    Held,
    Link,
    Look,
    Number,
    Place,
    Scene,
    numbers_of,
)

Generator = np.random.Generator


def _of_pendulum(length: float, damping: float, drag: float, body: int | None) -> list[Number]:
    told = [("length", length, "m"), ("omega", np.sqrt(GRAVITY / length), "rad/s")]
    told += [("damping", damping, "1/s")] if damping else []
    told += [("drag", drag, "1/m")] if drag else []
    return numbers_of(told, body)


GRAVITY_NUMBER = Number("g", GRAVITY, "m/s^2")


def _bob(random: Generator, length: float) -> Look:
    shape = str(random.choice(["ball", "weight"]))
    return Look(shape, float(np.clip(length * random.uniform(0.06, 0.1), 0.015, 0.06)))


def _pendulum(
    random: Generator,
    kind: str,
    link: str,
    degrees: tuple[float, float],
    drag: float = 0.0,
    hand: bool = False,
) -> Scene:
    length = random.uniform(0.25, 0.9)
    damping = 0.0 if drag else random.uniform(0.03, 0.25)
    angle = np.radians(random.uniform(*degrees)) * random.choice([-1, 1])
    held = None
    if hand:
        way = (float(np.sign(angle)), 0.15)
        held = Held(0, random.uniform(1.2, 2.0), way, (0.0, 0.0))
    return Scene(
        kind,
        PENDULUM,
        (length, damping, drag, angle, 0.0),
        (*_of_pendulum(length, damping, drag, 0), GRAVITY_NUMBER),
        random.uniform(5.0, 7.0) + (held.seconds if held else 0.0),
        (_bob(random, length),),
        (Link(link, (0.0, 0.0), 0),),
        (Fixture("stand", (0.0, 0.0), (0.0, 0.0)),),
        held=held,
    )


def pendulum_string(random: Generator) -> Scene:
    """A small swing on a string, losing to linear damping."""
    return _pendulum(random, "pendulum string", "string", (6, 25))


def pendulum_rod(random: Generator) -> Scene:
    """A large swing on a stiff rod."""
    return _pendulum(random, "pendulum rod", "rod", (45, 100))


def pendulum_air(random: Generator) -> Scene:
    """A swing that air slows: drag grows as the square of the speed."""
    return _pendulum(random, "pendulum air", "string", (25, 60), random.uniform(0.08, 0.4))


def pendulum_hand(random: Generator) -> Scene:
    """A hand draws the bob aside, waits and lets go."""
    return _pendulum(random, "pendulum hand", "string", (12, 45), hand=True)


def two_pendulums(random: Generator) -> Scene:
    """Two pendulums that know nothing of each other."""
    lengths = random.uniform(0.3, 0.45), random.uniform(0.5, 0.8)
    damping = random.uniform(0.03, 0.2, 2)
    angles = np.radians(random.uniform(8, 22, 2)) * random.choice([-1, 1], 2)
    aside = 1.35 * (lengths[0] * abs(np.sin(angles[0])) + lengths[1] * abs(np.sin(angles[1]))) + 0.1
    values: list[float] = []
    for k in (0, 1):
        values += [lengths[k], damping[k], 0.0, angles[k], 0.0]
    numbers = [n for k in (0, 1) for n in _of_pendulum(lengths[k], damping[k], 0.0, k)]
    pivots: tuple[Place, Place] = (0.0, 0.0), (aside, 0.0)
    return Scene(
        "two pendulums",
        TWO_PENDULUMS,
        (*values, *pivots[1]),
        (*numbers, GRAVITY_NUMBER),
        random.uniform(5.0, 7.0),
        (_bob(random, 0.4), _bob(random, 0.5)),
        tuple(Link("string", pivots[k], k) for k in (0, 1)),
        tuple(Fixture("stand", p, p) for p in pivots),
    )


def coupled_pendulums(random: Generator) -> Scene:
    """Two equal pendulums joined by a weak spring: the swing goes over and comes back."""
    length, damping = random.uniform(0.35, 0.7), random.uniform(0.02, 0.08)
    stiffness = random.uniform(0.08, 0.25) * GRAVITY / length
    aside = random.uniform(0.5, 0.7) * length
    first = np.radians(random.uniform(12, 20)) * random.choice([-1, 1])
    told = [
        ("length", length, "m"),
        ("omega", np.sqrt(GRAVITY / length), "rad/s"),
        ("damping", damping, "1/s"),
        ("stiffness", stiffness, "1/s^2"),
    ]
    bob = _bob(random, length)
    return Scene(
        "coupled pendulums",
        COUPLED_PENDULUMS,
        (length, damping, stiffness, aside, first, 0.0),
        (*numbers_of(told), GRAVITY_NUMBER),
        random.uniform(6.0, 8.0),
        (bob, bob),
        (Link("string", (0.0, 0.0), 0), Link("string", (aside, 0.0), 1), Link("spring", 0, 1)),
        (Fixture("stand", (0.0, 0.0), (aside, 0.0)),),
    )


def double_pendulum(random: Generator) -> Scene:
    """One pendulum hung from another, by rods, let go at rest."""
    upper, lower = random.uniform(0.2, 0.35, 2)
    ratio = random.uniform(0.4, 1.5)
    first, second = np.radians(random.uniform(20, 60, 2)) * random.choice([-1, 1], 2)
    told = [("length1", upper, "m"), ("length2", lower, "m"), ("mass_ratio", ratio, "1")]
    return Scene(
        "double pendulum",
        DOUBLE_PENDULUM,
        (upper, lower, ratio, first, second),
        (*numbers_of(told), GRAVITY_NUMBER),
        random.uniform(4.0, 6.0),
        (Look("ball", 0.026), Look("ball", 0.026 * ratio ** (1 / 3))),
        (Link("rod", (0.0, 0.0), 0), Link("rod", 0, 1)),
        (Fixture("stand", (0.0, 0.0), (0.0, 0.0)),),
    )


def _spring(random: Generator, kind: str, way: Place, wall: Place) -> tuple[Scene, float]:
    omega, damping = random.uniform(4.0, 9.0), random.uniform(0.08, 0.5)
    start = random.uniform(0.06, 0.11) * random.choice([-1, 1])
    told = [("omega", omega, "rad/s"), ("damping", damping, "1/s")]
    shape, radius = ("cart", 0.035) if way[0] else ("weight", random.uniform(0.025, 0.04))
    scene = Scene(
        kind,
        SPRING,
        (omega, damping, *way, start),
        tuple(numbers_of(told)),
        random.uniform(4.5, 7.0),
        (Look(shape, radius),),
        (Link("spring", wall, 0),),
    )
    return scene, radius


def spring(random: Generator) -> Scene:
    """A cart on a level rail, at a spring."""
    from dataclasses import replace

    scene, radius = _spring(random, "spring", (1.0, 0.0), (-0.3, 0.0))
    fixtures = (
        Fixture("rail", (-0.32, -radius), (0.3, -radius)),
        Fixture("wall", (-0.3, -radius), (-0.3, 0.06)),
    )
    return replace(scene, fixtures=fixtures)


def hanging_spring(random: Generator) -> Scene:
    """A weight that hangs from a spring, about its rest."""
    from dataclasses import replace

    scene, _ = _spring(random, "hanging spring", (0.0, 1.0), (0.0, 0.35))
    return replace(scene, fixtures=(Fixture("stand", (0.0, 0.35), (0.0, 0.35)),))


def two_masses(random: Generator) -> Scene:
    """Two carts between walls, three springs."""
    first, between, second = random.uniform(18, 45), random.uniform(6, 20), random.uniform(18, 45)
    ratio, damping, apart = random.uniform(1.0, 2.0), random.uniform(0.05, 0.25), 0.3
    starts = random.uniform(0.05, 0.09), random.uniform(-0.03, 0.03)
    told = [
        ("first_stiffness", first, "1/s^2"),
        ("between_stiffness", between, "1/s^2"),
        ("second_stiffness", second, "1/s^2"),
        ("mass_ratio", ratio, "1"),
        ("damping", damping, "1/s"),
    ]
    look, ends = Look("cart", 0.03), ((-0.28, 0.0), (apart + 0.28, 0.0))
    return Scene(
        "two masses",
        TWO_MASSES,
        (first, between, second, ratio, damping, apart, *starts),
        tuple(numbers_of(told)),
        random.uniform(5.0, 7.0),
        (look, look),
        (Link("spring", ends[0], 0), Link("spring", 0, 1), Link("spring", 1, ends[1])),
        (
            Fixture("rail", (-0.3, -0.03), (apart + 0.3, -0.03)),
            *(Fixture("wall", (x, -0.03), (x, 0.06)) for x, _ in ends),
        ),
    )
