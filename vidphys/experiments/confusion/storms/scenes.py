"""Classes of the harder scenes; what each draws, and what must be found in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.experiments.confusion.scenes import Kind, Law, Setting, path_of, total
from vidphys.experiments.confusion.storms import forces
from vidphys.experiments.confusion.storms.measured import MEASURES

STRENGTHS, LENGTHS, MASSES = 3.0, 1.5, 3.0  # each drawn from 1 / so much to so much times
SIGMAS, INTERVALS = (0.001, 0.005), (0.04, 0.08)  # world units, seconds
WEIGHED = 3  # bodies, up to which every second scene hides its masses from the diagnosis
TEMPERATURE = 0.3
ONE, MANY, SOME = (1, 2, 3, 5), (2, 3, 5), (3, 5)


class Draw:
    """The numbers of one scene.

    Args:
        rng: draws them.
        bodies: how many.
    """

    def __init__(self, rng: np.random.Generator, bodies: int) -> None:
        self.rng = rng
        self.mass = self._spread(MASSES, bodies)
        self.mass /= np.exp(np.log(self.mass).mean())

    def strength(self, usual: float) -> float:
        """A third to three times the usual, uniform in the logarithm."""
        return usual * float(self._spread(STRENGTHS))

    def length(self, usual: float) -> float:
        """Two thirds to one and a half times the usual."""
        return usual * float(self._spread(LENGTHS))

    def place(self) -> tuple[float, float]:
        """About where a trap has its centre."""
        x, y = self.rng.uniform(-0.4, 0.4, 2)
        return float(x), float(y)

    def field(self) -> np.ndarray:
        """A constant acceleration, any way round."""
        angle = self.rng.uniform(0, 2 * np.pi)
        return self.strength(0.8) * np.array([np.cos(angle), np.sin(angle)])

    def _spread(self, most: float, size: int | None = None) -> np.ndarray:
        return np.asarray(most ** self.rng.uniform(-1, 1, size))


@dataclass(frozen=True)
class Made:
    """What a class makes of a draw.

    Args:
        force: newtons, from places, speeds and time.
        bath: rate of a friction whose random kicks are added, per second times mass.
    """

    force: Law
    bath: float = 0.0


@dataclass(frozen=True)
class Class:
    """A class of scenes.

    Args:
        name: of the class.
        make: from its draw.
        truth: kinds of terms that must be found; ``None`` where the menu has no such scene.
        bodies: numbers of bodies that it may have.
        speed: of the first velocities, see :class:`vidphys.experiments.confusion.scenes.Kind`.
        unseen: bodies that no tracker follows, beside the others.
    """

    name: str
    make: Callable[[Draw], Made | Law]
    truth: frozenset[str] | None
    bodies: tuple[int, ...] = ONE
    speed: float = 0.7
    unseen: int = 0


@dataclass(frozen=True)
class Scene:
    """One recorded scene.

    Args:
        motion: as a tracker delivers it.
        known: whether the masses are told.
        sigma: of the noise, world units.
        bodies: that are seen.
    """

    motion: Motion
    known: bool
    sigma: float
    bodies: int


def filmed(some: Class, measure: str, seed: int) -> Scene:
    """One scene of a class, drawn and measured.

    Args:
        some: the class.
        measure: of :data:`vidphys.experiments.confusion.storms.measured.MEASURES`.
        seed: another one draws another scene.
    """
    rng = np.random.default_rng([seed, *some.name.encode(), 0, *measure.encode()])
    seen = int(rng.choice([n for n in some.bodies if n > 1 or measure != "swaps"] or some.bodies))
    draw = Draw(rng, seen + some.unseen)
    made = some.make(draw)
    made = made if isinstance(made, Made) else Made(made)
    mass = draw.mass[:, None]
    kind = Kind(
        f"{some.name} {measure}",
        lambda q, v, t: made.force(q, v, t) / mass,
        some.truth,
        some.bodies,
        some.speed,
        np.sqrt(2 * made.bath * TEMPERATURE) / mass,
    )
    sigma, interval = float(rng.choice(SIGMAS)), float(rng.choice(INTERVALS))
    path = path_of(kind, Setting(0.0, interval, seen + some.unseen, seed))[:, :, :seen]
    known = seen > WEIGHED or bool(rng.random() < 0.5)
    motion = motion_of(MEASURES[measure](path, sigma, rng), interval)
    if known:
        motion = replace(motion, mass=np.tile(draw.mass[:seen], (motion.clips, 1)))
    return Scene(motion, known, sigma, seen)


# what a class makes of its draw


def _trap(d: Draw) -> Law:
    return forces.held(d.strength(1.5), d.place())


def _fall(d: Draw) -> Law:
    return forces.weight(d.field(), d.mass)


def _linear(d: Draw) -> Law:
    return forces.resisted(d.strength(0.4), 1)


def _square(d: Draw) -> Law:
    return forces.resisted(d.strength(0.5), 2)


def _dry(d: Draw) -> Law:
    return forces.resisted(d.strength(0.25), 0)


def _drive(d: Draw) -> Law:
    return forces.resisted(-d.strength(0.25), 1)


def _gravity(d: Draw) -> Law:
    pull = forces.powered(d.strength(1.0), d.length(0.3), 2.0)
    return forces.between(pull, np.outer(d.mass, d.mass))


def _repulsion(d: Draw) -> Law:
    return forces.between(forces.powered(-d.strength(1.0), d.length(0.3), 2.0))


def _springs(d: Draw) -> Law:
    stiffness = d.strength(1.0)
    return forces.between(lambda r: stiffness * (r < 1e8))


def _disks(d: Draw) -> Law:
    return forces.between(forces.touching(d.strength(40.0), d.length(0.7)))


def _cutoff(d: Draw) -> Law:
    return forces.between(forces.cut_off(d.strength(3.0), d.length(2.0)))


def _power(d: Draw) -> Law:
    return forces.between(forces.powered(d.strength(1.0), d.length(0.3), d.rng.uniform(0.5, 3.0)))


def _uneven_trap(d: Draw) -> Law:
    turn = np.linalg.qr(d.rng.standard_normal((2, 2)))[0]
    own = np.array([1.0, d.rng.uniform(2.0, 5.0)]) * d.strength(0.8)
    return forces.held(turn @ np.diag(own) @ turn.T, d.place())


def _one_sided(d: Draw) -> Law:
    bodies = np.arange(len(d.mass))
    signs = np.where(bodies % 2 == 0, 1.5, -1.0)
    pull = forces.powered(d.strength(1.0), d.length(0.3), 2.0)
    return forces.between(pull, np.tile(signs, (len(bodies), 1)))


def _pairs_differ(d: Draw) -> Law:
    strengths = np.zeros((len(d.mass), len(d.mass)))
    for one, other in combinations(range(len(d.mass)), 2):
        strengths[one, other] = strengths[other, one] = d.rng.choice([-1, 1]) * d.strength(1.0)
    return forces.between(forces.powered(1.0, d.length(0.3), 2.0), strengths)


def _pushed(d: Draw) -> Law:
    return total(_trap(d), forces.pushed(2 * d.field(), d.length(1.2), d.length(0.5)))


def _flow(d: Draw) -> Law:
    gradient = d.strength(0.8) * d.rng.standard_normal((2, 2)) / np.sqrt(2)
    return forces.carried(d.strength(0.6), gradient)


def _follow(d: Draw) -> Law:
    return forces.following(d.strength(0.8), d.length(1.0))


def _bath(d: Draw, *laws: Law) -> Made:
    rate = d.strength(1.0)
    return Made(total(*laws, forces.resisted(rate, 1)), rate)


def _sum(*parts: Callable[[Draw], Law]) -> Callable[[Draw], Law]:
    return lambda d: total(*(part(d) for part in parts))


def _terms(*kinds: str) -> frozenset[str]:
    return frozenset(kinds)


LISTED = {
    some.name: some
    for some in (
        Class("inertial", lambda d: lambda q, v, t: np.zeros_like(q), _terms()),
        Class("projectile", _fall, _terms("uniform")),
        Class("trap", _trap, _terms("trap")),
        Class("drag", _linear, _terms("linear"), speed=1.0),
        Class("falling-drag", _sum(_fall, _linear), _terms("uniform", "linear")),
        Class("trap-drag", _sum(_trap, _linear), _terms("trap", "linear")),
        Class("trap-square", _sum(_trap, _square), _terms("trap", "square")),
        Class("trap-dry", _sum(_trap, _dry), _terms("trap", "dry")),
        Class("trap-drive", _sum(_trap, _drive), _terms("trap", "drive")),
        Class("gravity", _gravity, _terms("pair"), MANY),
        Class("repulsion", _repulsion, _terms("pair"), MANY),
        Class("springs", _springs, _terms("pair"), MANY),
        Class("gravity-drag", _sum(_gravity, _linear), _terms("pair", "linear"), MANY),
        Class("gravity-square", _sum(_gravity, _square), _terms("pair", "square"), MANY),
        Class("gravity-field", _sum(_gravity, _fall), _terms("pair", "uniform"), MANY),
        Class("repulsion-trap", _sum(_repulsion, _trap), _terms("pair", "trap"), MANY),
        Class("disks-trap", _sum(_disks, _trap), _terms("contact", "trap"), MANY),
        Class("langevin", lambda d: _bath(d, _trap(d)), _terms("trap", "linear", "bath")),
        Class(
            "langevin-pairs",
            lambda d: _bath(d, _gravity(d), _trap(d)),
            _terms("pair", "trap", "linear", "bath"),
            MANY,
        ),
        Class("cutoff", _cutoff, _terms("pair"), MANY),
        Class("power", _power, _terms("pair"), MANY),
        Class("linear-and-dry", _sum(_trap, _linear, _dry), _terms("trap", "linear", "dry")),
        Class(
            "linear-and-square",
            _sum(_trap, _linear, _square),
            _terms("trap", "linear", "square"),
            speed=1.2,
        ),
        Class("pair-and-contact", _sum(_gravity, _disks), _terms("pair", "contact"), MANY),
        Class("outside-magnetic", lambda d: total(_trap(d), forces.across(d.strength(1.0))), None),
        Class("outside-waning", lambda d: forces.varying(_gravity(d), d.strength(2.5)), None, MANY),
        Class(
            "outside-uneven-drag",
            lambda d: forces.resisted_unevenly((d.strength(0.1), d.strength(0.9))),
            None,
            speed=1.0,
        ),
        Class("outside-triple", lambda d: forces.three_together(d.strength(1.0)), None, SOME),
        Class("outside-one-sided", _one_sided, None, MANY),
        Class("outside-uneven-trap", _uneven_trap, None),
        Class("outside-pairs-differ", _pairs_differ, None, SOME),
        Class("outside-pushed", _pushed, None),
        Class("outside-flow", _flow, None),
        Class("outside-hidden", _gravity, None, MANY, unseen=1),
        Class("outside-walls", lambda d: forces.walled(d.length(1.0)), None, speed=1.0),
        Class(
            "outside-drag-by-place",
            lambda d: total(_trap(d), forces.resisted_by_place(d.strength(0.4))),
            None,
        ),
        Class("outside-follow", _follow, None, MANY),
    )
}
