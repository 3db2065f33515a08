"""Fitted laws in words: how bodies move, by what, with which numbers, and what is left."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from vidphys.diagnose.explanations.collided import collided
from vidphys.diagnose.explanations.equations import of_law
from vidphys.diagnose.mechanisms.charts import Plane, Turned
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.mechanism import Group, Mechanism
from vidphys.diagnose.mechanisms.quantities import Quantity, quantities
from vidphys.diagnose.mechanisms.unfollowed import OwnSwing
from vidphys.diagnose.recordings.units import GRAVITY, Units
from vidphys.statistics import NORMAL_95, as_ratio, with_error

SCALED = "as the picture's scale differs from place to place; a length that is known would tell"
ROLLS = 5 / 7  # of gravity, that speeds up a solid ball that rolls (2/5 m r^2 turns with it)

ON = {
    "plane": "moves freely",
    "turned": "moves freely",
    "line": "moves on a line",
    "angle": "swings",
    "arc": "swings on an arc",
    "curve": "moves along a curve, which all frames draw",
}
BY = {
    "none": "nothing pulls it",
    "uniform": "under a constant acceleration",
    "trap": "about a place that it is pulled back to, as a spring does",
    "pendulum": "as a pendulum",
    "chain": "as two rods that hang end on end",
    "centre": "a fixed place pushes it away, by a power of the distance",
    "elastic": "a spring of a rest length ties it to a fixed place, under a constant acceleration",
    "string": "on a string from a fixed place, under a constant acceleration",
}
LOSES = {
    "linear": "friction goes with its speed",
    "square": "friction goes with the square of its speed",
    "dry": "dry friction",
}
SHORT = {
    "linear": "friction ~ v",
    "square": "friction ~ v²",
    "dry": "dry friction",
    "uniform": "constant acceleration",
    "trap": "spring to a place",
    "pendulum": "pendulum on an arc",
    "centre": "a fixed place that pushes or pulls",
    "elastic": "spring from a fixed place, constant acceleration",
    "string": "string from a fixed place, constant acceleration",
    "lift": "lift by its spin",
    "turning": "force across its way ~ v",
    "forcing": "sinusoid that drives it",
    "curve": "a curve that it keeps to",
}


def in_short(kinds: Collection[str]) -> str:
    """Terms in a few words.

    Example:
        >>> in_short({"uniform", "linear"})
        'friction ~ v, constant acceleration'
    """
    return ", ".join(SHORT.get(kind, kind) for kind in sorted(kinds)) or "no force"


def told(group: Group, units: Units, alone: bool) -> list[str]:
    """How bodies move, by what, and the numbers of it.

    Args:
        group: of the bodies.
        units: in which lengths are told.
        alone: whether there is no other body.
    """
    fit, law = group.fit, group.fit.model.law
    who = "The body" if alone else bodies_named(group.bodies)
    several = len(group.bodies) > 1
    moves = _plural(_where(fit)) if several else _where(fit)
    how = [BY[law.restoring], *(LOSES[x] for x in law.frictions)]
    if fit.numbers.get("strength", (0.0, 0.0))[0] < 0:
        how[0] = how[0].replace("pushes it away", "pulls it")
    if law.restoring == "centre" and law.power({n: x for n, (x, _) in fit.numbers.items()}) < 0:
        how[0] = f"{how[0]}, with which it grows"
    if law.restoring == "string" and law.coordinates == 2:  # a taut one is a pendulum's
        how[0] = how[0].replace("string", "string that goes slack", 1)
    if law.restoring == "centre" and several:
        how[0] = how[0].replace(" it", " them", 1)
    if isinstance(fit.model.charts[0], Turned):
        how[0] = f"{how[0]} along each of two directions"
    if fit.driven:
        how[1] = "something drives it"
    if law.inputs and fit.clips[0].inputs is not None:
        how.append(f"the known {' and '.join(fit.clips[0].inputs.names)} pushes it")
    if law.forced:
        how.append("a sinusoid that is not recorded drives it")
    if law.lift_fades is not None:
        how.append("a lift across its way goes with its spin and its speed")
    if law.turning:
        how.append(
            "a force across its way goes with its speed, as in a magnetic field or a frame that "
            "turns"
        )
    if law.walls:
        it = "they bounce" if several else "it bounces"
        how.append(f"{it} off a wall" if len(law.walls) == 1 else f"{it} off walls")
        how += ["it spins, and is gripped there"] if law.spins else []
    if law.coupled:
        what = "neighbours" if law.ties else "the bodies"
        how.append(f"springs hold {what} together")
    if "collision" in law.kinds:
        how[0] = "nothing pulls them" if law.restoring == "none" else how[0]
        how.append("they collide")
    how = [_of_several(x) for x in how] if several else how
    how = _in_a_row(how, law, group.bodies) if law.loose else how
    known = quantities(fit, units.ends)
    numbers = (*collided(fit, group.bodies), *(number(x, units) for x in known))
    return [
        f"{who} {moves}: {'; '.join(how)}.",
        f"  {of_law(fit, (x.name for x in known)).line}",
        *(f"  {x}" for x in (*numbers, *_ruler(law, known, units))),
    ]


def _in_a_row(how: Sequence[str], law: Law, bodies: Sequence[int]) -> list[str]:
    """What is said of bodies of which some are held by the springs between them alone."""
    held = [body for i, body in enumerate(bodies) if i not in law.loose]
    loose = [body for i, body in enumerate(bodies) if i in law.loose]
    by = _of_several(BY[law.restoring]) if len(held) > 1 else BY[law.restoring]
    last = f"{how[-1]}, and nothing else pulls {bodies_named(loose).lower()}"
    return [f"{bodies_named(held).lower()} {by}", *how[1:-1], last]


def _of_several(said: str) -> str:
    """What is said of a body, of each of several."""
    each = "each " if said.startswith("about a place") else ""
    return each + said.replace(" its speed", " their speed").replace("drives it", "drives them")


def bodies_named(bodies: Sequence[int]) -> str:
    """Bodies by their numbers, at the beginning of a sentence."""
    *first, last = (str(body + 1) for body in bodies)
    return f"Bodies {', '.join(first)} and {last}" if first else f"Body {last}"


def number(x: Quantity, units: Units) -> str:
    """With its interval and unit; between which limits it lies where it is not told."""
    value, error = (units.told(v, x.length) for v in (x.value, NORMAL_95 * x.error))
    unit = units.named(x.length, x.seconds)
    ending = f"{f' {unit}' if unit else ''} (95 %)"
    if x.known:
        return f"{x.name} {with_error(value, error)}{ending}"
    between = f"between {value - error:.2g} and {value + error:.2g}{ending}"
    if x.measured:
        return f"{x.name}: {between}, {SCALED}"
    return f"{x.name}: not told by this recording, {between}"


def what_is_left(mechanism: Mechanism, units: Units) -> str:
    """How much the laws miss, and whether it lasts."""
    worst = max((group.fit.errors for group in mechanism.groups), key=lambda e: e.total)
    text = f"What is left is {units.length(mechanism.left)}"
    if worst.smooth > worst.white:
        return text + (
            f", and lasts for {worst.memory:.2g} s, as a lens, perspective or a tracker's slow "
            "mistakes leave it."
        )
    return text + ", different in every frame, as noise is."


def beside(body: int, swing: OwnSwing, units: Units, alone: bool) -> str:
    """Of a swing that is left of a body's: what it tells of, and what would tell more."""
    whose = "" if alone else f" of body {body + 1}'s way"
    return (
        f"What is left{whose} swings by itself, by {units.length(swing.size)} at "
        f"{swing.rate:.3g} rad/s, as no error of a camera does: something that was not followed "
        "moves with it. A recording in which all that hangs or is tied together is followed would "
        "tell."
    )


def tied(one: int, other: int) -> str:
    """Of two bodies that swing in step: what that may come from, and what would tell."""
    return (
        f"In doubt: bodies {one + 1} and {other + 1} swing in step, as what is tied together does, "
        "or hangs from what moves. Let them go otherwise."
    )


def kept_in_balance(mass: np.ndarray) -> str:
    """Of bodies told each by itself whose centre of mass moves as if they acted on each other."""
    return (
        f"In doubt: with masses as {as_ratio(mass)} the bodies keep their balance, as those do "
        "that act on each other; their laws may stand for that."
    )


def _ruler(law: Law, told: Sequence[Quantity], units: Units) -> list[str]:
    """What gravity says of lengths: a falling or a hanging body is a ruler."""
    known = {x.name: x.value for x in told}
    if "rate" in known and law.restoring in ("pendulum", "string"):
        metres = GRAVITY / known["rate"] ** 2
        length = f"if it hangs in {GRAVITY} m/s², it is {metres:.3g} m long"
        if "length" in known and units.name != "m":
            unit = units.name or "units of the positions"
            long = f"{units.told(known['length'], 1) / metres:.4g} {unit}"
            return [f"{length} (a plain pendulum), and 1 m is {long}"]
        return [f"{length} (a plain pendulum)"]
    if "acceleration" in known and units.name == "px":
        metre = units.told(known["acceleration"], 1) / GRAVITY
        if law.curve is not None:
            slides = f"if it slides in {GRAVITY} m/s², 1 m is {metre:.4g} px"
            return [f"{slides}; if it rolls as a solid ball, {metre / ROLLS:.4g} px"]
        return [f"if it falls at {GRAVITY} m/s², 1 m is {metre:.4g} px"]
    return []


def _where(fit: Fit) -> str:
    chart = fit.model.charts[0]
    return ON["line" if isinstance(chart, Plane) and chart.space == 1 else chart.name]


def _plural(said: str) -> str:
    verb, _, rest = said.partition(" ")
    return f"{verb.removesuffix('s')} {rest}".strip()
