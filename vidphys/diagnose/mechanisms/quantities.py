"""The numbers that a physicist asks of a fitted law, each with its standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.charts import Arc, Turned
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.rods import RodsFit
from vidphys.diagnose.mechanisms.starts.centre import nearest
from vidphys.diagnose.mechanisms.terms import COULOMB, FORCING
from vidphys.diagnose.recordings.units import Ends
from vidphys.statistics import NORMAL_95

NUDGE = 1e-5
SLIGHT = 1e-6  # of two masses, that one has at least
# Over a fit's own standard errors, of what was seen in a picture. Of 289 numbers of clips that were
# filmed for development, 92 % lay inside intervals without it, and 96 % with it.
SEEN = 1.3
VAGUE = 0.3  # of a number, by which its 95 % interval reaches either way: beyond, it is not known
ASKEW = 0.015  # of a length, that a plane shows it shorter by which is turned by ten degrees

AXES = (" about x", " about y", " about z")
ALONG = {  # of walls
    "restitution": "restitution",
    "along": "speed kept along the wall",
    "grip": "tangential restitution",
}


@dataclass(frozen=True)
class Quantity:
    """A number with its unit.

    Args:
        name: for people and programs.
        value, error: and its standard error, units of the positions and seconds.
        length, seconds: powers of those units that it goes with.
        scale: the part of the error that is a picture's scale's, which differs from place to place.
    """

    name: str
    value: float
    error: float
    length: int = 0
    seconds: int = 0
    scale: float = 0.0

    @property
    def known(self) -> bool:
        """Whether the recording tells it, and not only within which wide limits it lies."""
        return NORMAL_95 * self.error <= VAGUE * abs(self.value)

    @property
    def measured(self) -> bool:
        """Whether it would be known if the scale were: longer recordings do not tell a scale."""
        own = np.sqrt(max(self.error**2 - self.scale**2, 0.0))
        return bool(NORMAL_95 * own <= VAGUE * abs(self.value))


Joint = Callable[[np.ndarray, tuple[np.ndarray, ...]], float]


def quantities(fit: Fit, ruler: Ends | None = None) -> list[Quantity]:
    """Of a fit, those that can be told.

    Args:
        fit: of a law.
        ruler: places in a picture between which a length is known: lengths are told in the scale in
            which the camera shows that one, otherwise in that of the picture's middle.
    """
    camera = fit.model.view(fit.values)
    seen = None if camera is None or ruler is None else np.array(ruler)
    asked = [
        Quantity(name, *_with_error(fit, _in_scale(fit, told, seen, length)), length, seconds)
        for name, told, length, seconds in _asked(fit)
    ]
    if isinstance(fit, RodsFit):
        return [*asked, *_of_rods(fit, ruler)]
    if fit.model.law.curve is not None:  # which is drawn no better than by what is left
        share = fit.left / fit.spread
        asked = [replace(x, error=float(np.hypot(x.error, share * x.value))) for x in asked]
    if camera is None:
        return asked
    share = ASKEW if seen is not None else float(np.hypot(ASKEW, _unevenness(fit, camera)))
    return [_wider(x, share) for x in asked]


def _in_scale(fit: Fit, told: Joint, ruler: np.ndarray | None, length: int) -> Joint:
    """A number of so many powers of length, in the scale in which a ruler is seen."""
    if ruler is None or not length:
        return told

    def scaled(values: np.ndarray, geometry: tuple[np.ndarray, ...]) -> float:
        camera = fit.model.view(values)
        assert camera is not None
        return told(values, geometry) / view.enlarged(ruler, camera) ** length

    return scaled


def _unevenness(fit: Fit, camera: np.ndarray) -> float:
    """What no motion tells: where in the picture, and along which way, a length is known."""
    told = np.array([fit.numbers[name] for name in view.NAMES])
    shown = camera * camera**2 / (camera**2 + told[:, 1] ** 2)  # a view that is vague is slight
    return view.unevenness(shown)


def _wider(quantity: Quantity, share: float) -> Quantity:
    """Seen in a picture whose scale is uncertain by a share of itself."""
    scale = abs(share * quantity.value * quantity.length)
    error = SEEN * float(np.hypot(quantity.error, scale))
    return replace(quantity, error=error, scale=SEEN * scale)


def _of_rods(fit: RodsFit, ruler: Ends | None) -> Iterator[Quantity]:
    """Their lengths, and the mass at the lower one's end over that at the upper one's."""
    (upper, lower), (vague, vaguer) = fit.rods.lengths, fit.rods.errors
    scale = 1.0 if ruler is None else view.enlarged(np.array(ruler), fit.rods.camera)
    anywhere = view.unevenness(fit.rods.camera) if ruler is None else 0.0
    for which, length, error in ((1, upper, vague), (2, lower, vaguer)):
        error = np.hypot(error, anywhere * length)
        yield Quantity(f"length {which}", float(length / scale), float(error / scale), 1)
    link, error = fit.numbers["link"]
    share = link * upper / lower  # of both masses, that the lower one has
    if 0 < share < 1:
        relative = np.hypot(np.hypot(error / link, ASKEW), np.hypot(vague / upper, vaguer / lower))
        ratio = float(share / (1 - share))
        yield Quantity("mass ratio", ratio, float(ratio * relative / (1 - share)))


def _asked(fit: Fit) -> Iterator[tuple[str, Joint, int, int]]:
    """Name, how it follows from values and geometry, and its powers of length and seconds."""
    law = fit.model.law
    at = {name: i for i, name in enumerate(law.names)}

    def number(name: str) -> Joint:
        return lambda values, _: float(values[at[name]])

    for name in law.names:
        root, _, which = name.partition(" ")
        of = f" {which}" if which and law.apart else ""
        if root in ("stiffness", "swing"):
            # Of the lower one of two rods, as if it hung alone.
            over = at["inertia"] if name == "swing 2" and law.restoring == "chain" else None
            yield f"rate{of}", _rate(at[name], 1.0, over), 0, -1
            yield f"period{of}", _rate(at[name], -1.0, over), 0, 1
        elif root in ("linear", "square", "dry"):
            length, seconds = {"linear": (0, -1), "square": (-1, 0), "dry": (1, -2)}[root]
            turns = fit.model.charts[0].name in ("arc", "angle")
            if root == "dry" and law.curve is not None:
                yield "friction coefficient", number(name), 0, 0
                continue
            whose = f"{root} friction {which}".strip()
            yield whose, number(name), 0 if turns else length, seconds
        elif root in ("inertia", "link"):  # of the equations of two rods
            yield f"{root} ratio", number(name), 0, 0
        elif root == "mass":  # over the first body's
            several = f" {which}" if "mass 3" in law.names else ""
            yield f"mass ratio{several}", number(name), 0, 0
        elif root == "reach":
            several = f" {which}" if "reach 2" in law.names else ""
            yield f"distance at contact{several}", number(name), 1, 0
        elif root == "rub":
            yield "speed across lost at contact", number(name), 0, 0
        elif root in ALONG:
            said = ALONG[root]
            if "mass 2" in law.names:
                which = f"at wall {which}" if which else ""
            elif len(law.walls) < 2:
                which = ""
            yield f"{said} {which}".strip(), number(name), 0, 0
        elif root == "spin":
            yield "surface's speed over the ball's, at first", number(name), 0, 0
        elif root == "gain":
            signal = fit.clips[0].inputs
            assert signal is not None
            length = 0 if fit.model.charts[0].name in ("arc", "angle") else 1
            yield f"acceleration by one {signal.names[int(which) - 1]}", number(name), length, -2
        elif root == "lift":
            yield "lift over speed, at first", number(name), 0, -1
        elif root == "nearing":
            yield "nearing", number(name), 0, -1
    if law.turning:
        for name, about in zip(law.turns, [""] if len(law.turns) == 1 else AXES, strict=True):
            yield f"turning{about}", number(name), 0, -1
    if law.forced:
        forcing = [at[name] for name in FORCING[:-1]]
        turns = fit.model.charts[0].name in ("arc", "angle")
        strongest = "strongest acceleration by what drives it"
        yield (
            strongest,
            lambda values, _: float(np.linalg.norm(values[forcing])),
            0 if turns else 1,
            -2,
        )
        yield "rate of what drives it", number(FORCING[-1]), 0, -1
    if law.restoring == "centre":
        yield "acceleration at the nearest distance", lambda v, _: _at_nearest(fit, v), 1, -2
        yield (
            "power of the distance",
            lambda values, _: COULOMB + float(values[at["steeper"]]),
            0,
            0,
        )
        yield "nearest distance", lambda values, _: nearest(replace(fit, values=values)), 1, 0
    if law.restoring == "chain" and not isinstance(fit, RodsFit):
        yield from _of_weights(fit)
    if law.restoring == "elastic":
        yield "rest length", number("rest"), 1, 0
    if law.restoring == "string":
        yield from _of_string(law)
    if law.restoring in ("uniform", "elastic", "string"):
        forces = [at[name] for name in law.forces]
        yield "acceleration", lambda values, _: float(np.linalg.norm(values[forces])), 1, -2
    if law.coupled:
        yield from _of_springs(law)
    chart = fit.model.charts[0]
    if isinstance(chart, Arc):
        yield "length", lambda _, geometry: chart.length(geometry[0]), 1, 0
    if isinstance(chart, Turned):
        yield "degrees from x to direction 1", lambda _, geometry: chart.degrees(geometry[0]), 0, 0


def _at_nearest(fit: Fit, values: np.ndarray) -> float:
    """What a fixed place does to a body at the nearest distance; below 0 where it pulls."""
    law, numbers = fit.model.law, dict(zip(fit.model.law.names, values, strict=False))
    nearer = law.near(numbers) / nearest(replace(fit, values=values))
    return float(numbers["strength"] * nearer ** law.power(numbers))


def _of_springs(law: Law) -> Iterator[tuple[str, Joint, int, int]]:
    """How fast two bodies would swing by the spring between them alone, and their masses over the
    first one's.
    """
    pulls = [law.names.index(f"coupling {i + 1}") for i in range(law.coordinates)]
    alone = law.coordinates == 2

    def rate(pair: tuple[int, int]) -> Joint:
        both = [pulls[i] for i in pair]
        return lambda values, _: float(np.sqrt(abs(values[both].sum()) / (len(pulls) - 1)))

    def over_first(pull: int) -> Joint:
        return lambda values, _: float(values[pulls[0]] / values[pull])

    for one, other in law.springs:
        which = "" if alone else f" {one + 1} and {other + 1}"
        yield f"rate of the spring between{which}", rate((one, other)), 0, -1
    for i, pull in enumerate(pulls[1:], 2):
        yield "mass ratio" if alone else f"mass ratio {i}", over_first(pull), 0, 0


def _of_string(law: Law) -> Iterator[tuple[str, Joint, int, int]]:
    """How fast a weight on it swings a little: known far better than its length and the field."""
    long, field = law.names.index("rest"), [law.names.index(name) for name in law.forces]

    def rate(values: np.ndarray, _: tuple[np.ndarray, ...]) -> float:
        return float(np.sqrt(np.linalg.norm(values[field]) / abs(values[long])))

    yield "rate", rate, 0, -1
    yield "period", lambda values, geometry: 2 * np.pi / rate(values, geometry), 0, 1
    yield "length", lambda values, _: float(values[long]), 1, 0


def _rate(at: int, power: float, over: int | None = None) -> Joint:
    def told(values: np.ndarray, _: tuple[np.ndarray, ...]) -> float:
        square = values[at] if over is None else values[at] / values[over]
        rate = float(np.sqrt(max(square, np.finfo(float).tiny)))
        return rate if power > 0 else 2 * np.pi / rate

    return told


def _of_weights(fit: Fit) -> Iterator[tuple[str, Joint, int, int]]:
    """What two angles tell of two weights on rods without mass, if that is what they may be.

    With link b = m_2 l_2 / ((m_1 + m_2) l_1) and inertia a = b l_2 / l_1, what the lower one hangs
    by is b times what the upper one hangs by.
    """
    at = {name: i for i, name in enumerate(fit.model.law.names)}
    upper, lower, link, inertia = (at[x] for x in ("swing 1", "swing 2", "link", "inertia"))
    off, error = _with_error(fit, lambda x, _: float(x[lower] - x[link] * x[upper]))
    if abs(off) > NORMAL_95 * error:
        return

    def share(values: np.ndarray) -> float:  # of both masses, that the lower one has
        return float(np.clip(values[link] ** 2 / values[inertia], SLIGHT, 1 - SLIGHT))

    yield "length 2 over length 1", lambda x, _: float(x[inertia] / x[link]), 0, 0
    yield "mass ratio", lambda x, _: share(x) / (1 - share(x)), 0, 0


def _with_error(fit: Fit, told: Joint) -> tuple[float, float]:
    """A number and its standard error, by its slope along every number of the fit."""
    joint = np.concatenate([fit.values, *fit.geometry])
    ends = np.cumsum([len(fit.values), *(len(g) for g in fit.geometry)])

    def at(x: np.ndarray) -> float:
        parts = tuple(x[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True))
        return told(x[: ends[0]], parts)

    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 0))
    slope = np.zeros(len(joint))
    for i in np.flatnonzero(spread):
        nudge = min(NUDGE * spread[i], 0.01 * abs(joint[i]) or NUDGE * spread[i])
        step = np.zeros(len(joint))
        step[i] = nudge
        slope[i] = (at(joint + step) - at(joint - step)) / (2 * nudge)
    return at(joint), float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0)))
