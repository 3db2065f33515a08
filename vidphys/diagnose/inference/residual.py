"""What the chosen terms leave: nothing but noise, random kicks, or a force that the menu lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc

from vidphys.diagnose.inference.menu import FRICTION, FRICTIONS, PAIR, Field, field_of
from vidphys.diagnose.inference.probes import hidden, probe_gains, probes_of, with_any_shape
from vidphys.diagnose.inference.refine import Fitted
from vidphys.diagnose.weak.regression import Rows, normal_equations, rows_of
from vidphys.diagnose.weak.windows import Windows
from vidphys.statistics import NORMAL_95

EXCESS = 0.05  # share of the noise's variance by which a residual may exceed it
SPREADS = 5.0  # and standard deviations of a mean square
BALANCE = 8.0  # factor within which the temperatures of kicks and of motion must agree
ESTIMATED = 1.35  # times that, where the noise's memory was estimated from the residual itself
UNEVEN, SLACK = 1e-4, 1.3  # chance; share by which a window's own noise may exceed the average
HIDES = 0.04  # of the forces that were found: a standard error from which a hidden one counts
CERTAIN = 30.0  # gain of log likelihood by a force off the menu, from which it surely is there
# Frames that a speed must last against friction or a drive to be told; beside random kicks, which
# the smoothing of paths takes for noise where they fade sooner, so that a temperature is too low.
LASTING, LASTING_BESIDE_KICKS = 1.0, 4.0
# Variances that are tried of what kicks do to a row, over that of the noise of a position.
VARIANCES = np.concatenate([[0.0], np.geomspace(1e-5, 1e8, 40)])


@dataclass(frozen=True)
class Kicks:
    """Random kicks beside the chosen terms.

    Args:
        ratio: their variance per second over that of the noise of a position, per second cubed.
        gain: of log likelihood over no kicks.
        moved: root mean square of what they do to a row, world units.
    """

    ratio: float
    gain: float
    moved: float


def random_kicks(rows: Rows, chosen: list[int], floor: float) -> Kicks:
    """The most likely strength of white kicks, the coefficients of ``chosen`` columns free.

    Args:
        rows: of all columns.
        chosen: columns that stand in the model.
        floor: see :func:`vidphys.diagnose.inference.structures.all_structures`.
    """
    ratio, gain = _likeliest(rows, chosen, floor, rows.kicks)
    normal = normal_equations(Rows(rows.x[:, chosen], rows.y, rows.kicks, rows.window), ratio)
    everything = range(len(chosen))
    variance = normal.misfit(everything, normal.solve(everything)) / normal.count
    moved = float(np.sqrt(ratio * max(variance, floor**2) * rows.kicks.mean()))
    return Kicks(ratio, gain, moved)


def _likeliest(
    rows: Rows, chosen: list[int], floor: float, shape: np.ndarray
) -> tuple[float, float]:
    few = Rows(rows.x[:, chosen], rows.y, shape, rows.window)
    everything = list(range(len(chosen)))

    def log_likelihood(ratio: float) -> float:
        normal = normal_equations(few, ratio)
        return normal.log_likelihood(normal.misfit(everything, normal.solve(everything)), floor)

    ratios = VARIANCES / shape.mean()
    found = np.array([log_likelihood(ratio) for ratio in ratios])
    best = int(found.argmax())
    if not 1 < best < len(ratios) - 1:
        return float(ratios[best]), float(found[best] - found[0])
    ends = np.log(ratios[[best - 1, best + 1]])
    between = minimize_scalar(
        lambda x: -log_likelihood(np.exp(x)), bounds=ends, method="bounded", options={"xatol": 0.02}
    )
    return float(np.exp(between.x)), float(-between.fun - found[0])


def smooth_force_gain(windows: Windows, rows: Rows, chosen: list[int], floor: float) -> float:
    """Gain of log likelihood by a force that changes smoothly within a window, at its best."""
    there = windows.informative
    gains = []
    for share in (0.5, 1.0, 2.0):
        since = windows.nodes * windows.length[:, None] / 2
        reach = share * windows.length[:, None, None]
        alike = np.exp(-0.5 * ((since[:, :, None] - since[:, None]) / reach) ** 2)
        spread = np.einsum("wnkm,wml,wnkl->wnk", windows.weak, alike, windows.weak)
        shape = np.repeat(spread[there], windows.frames.shape[-1])
        gains.append(_likeliest(rows, chosen, floor, shape)[1])
    return max(gains)


@dataclass(frozen=True)
class Leftover:
    """What noise and the chosen terms do not explain.

    Args:
        excess: mean square residual over the noise's variance as differences give it.
        allowed: the largest such ratio that noise alone explains.
        kicks_gain: of log likelihood by random kicks.
        smooth_gain: of log likelihood by a smoothly changing force.
        probes: forces that the menu lacks and that the data ask for, with their gain of log
            likelihood less its price.
        explained: whether the menu explains the motion.
        why: one sentence.
        uneven: how unlikely it is that noise alone left so much more in some windows than in
            others; the chance, by chi-square, of the worst window and body.
        hidden: how large forces that the menu lacks may be and not show, by their names: a standard
            error, over the forces that were found; where there are none, over one that would stop
            the bodies within the recording.
    """

    excess: float
    allowed: float
    kicks_gain: float
    smooth_gain: float
    probes: dict[str, float]
    explained: bool
    why: str
    uneven: float
    hidden: dict[str, float]

    @property
    def unseen(self) -> str:
        """The force that the menu lacks and that would show least; empty if all would show."""
        least = max(self.hidden, key=self.hidden.__getitem__, default="")
        return least if least and self.hidden[least] > HIDES else ""

    @property
    def even(self) -> bool:
        """Whether what is left over is as much everywhere as noise leaves."""
        return self.uneven > UNEVEN

    @property
    def certain(self) -> bool:
        """Whether it is sure that something is there that the menu lacks.

        What a few windows alone ask for may be an encounter that frames do not resolve.
        """
        asked = max(self.probes.values(), default=0.0) > CERTAIN
        return not self.explained and self.even and asked


def leftover(
    windows: Windows, fitted: Fitted, ratio: float, sigma: float, floor: float
) -> Leftover:
    """Judge the residual of a fitted structure.

    Args:
        windows: what was recorded.
        fitted: the structure, its numbers, and paths.
        ratio: of random kicks in the model, 0 if none.
        sigma: noise by differences, world units.
        floor: see :func:`vidphys.diagnose.inference.structures.all_structures`.
    """
    structure = fitted.structure
    field = field_of(windows, fitted.paths)
    columns = [term.columns(field) for term in structure.terms]
    if structure.term(FRICTION) is None:
        columns.append(FRICTIONS["linear"].columns(field))
    base = sum(c.shape[-1] for c in columns)
    places, at = {}, base
    forces = probes_of(field, structure)
    for name, probe in forces.items():
        columns.append(probe)
        places[name] = list(range(at, at + probe.shape[-1]))
        at += probe.shape[-1]
    rows = rows_of(windows, np.concatenate(columns, -1))
    chosen = list(range(base))
    kicks = random_kicks(rows, chosen, floor)
    smooth = smooth_force_gain(windows, rows, chosen, floor) if kicks.gain > 0 else 0.0
    normal = normal_equations(rows, ratio)
    probes = probe_gains(normal, chosen, places, ratio, floor)
    pair = structure.term(PAIR)
    if probes and pair is not None:
        shaped, free = with_any_shape(rows, windows, field, pair)
        beside = normal_equations(shaped, ratio)
        gains = probe_gains(beside, chosen + free, places, ratio, floor)
        probes = {name: min(gain, gains[name]) for name, gain in probes.items() if name in gains}
    allowed = 1 + max(EXCESS, SPREADS * float(np.sqrt(2 / fitted.freedom)))
    if windows.colour is not None:
        allowed *= ESTIMATED
    excess = fitted.variance / sigma**2
    doubt = ""
    if ratio and not _one_temperature(fitted, ratio * fitted.variance, field, windows):
        doubt = "random kicks and friction do not belong to one temperature"
    elif not _lasts(fitted, LASTING_BESIDE_KICKS if ratio else LASTING, windows):
        doubt = "speeds change faster than frames show: record more often, or the tracks jump"
    why = _judged(excess, allowed, kicks.gain, smooth, probes, ratio, doubt)
    sizes = hidden(normal, chosen, places, forces, floor)
    moved = structure.accelerations(field) if structure.terms else field.v / np.ptp(field.t)
    size = float(np.sqrt((moved**2).sum(-1).mean()))
    return Leftover(
        excess,
        allowed,
        kicks.gain,
        smooth,
        probes,
        not why,
        why or "nothing above the noise is left over",
        _unevenness(windows, fitted, ratio, floor),
        {name: least / max(size, np.finfo(float).tiny) for name, least in sizes.items()},
    )


def _unevenness(windows: Windows, fitted: Fitted, ratio: float, floor: float) -> float:
    """Chance that noise leaves as much in the worst window of a body, of all there are."""
    white = windows.whitening(ratio) @ fitted.residual.transpose(0, 2, 1, 3)
    power = (white**2).sum((2, 3)) / max(fitted.variance, floor**2)
    freedom = np.clip(windows.seen.sum(1) - 2, 1, None) * fitted.residual.shape[-1]
    worst = chdtrc(freedom, power / SLACK)
    return float(min(1.0, worst.min() * worst.size))


def _lasts(fitted: Fitted, frames: float, windows: Windows) -> bool:
    """Whether a speed lasts so many frames against what goes with it."""
    law = fitted.structure.term(FRICTION)
    if law is None or law.kind != "linear":
        return True
    return abs(friction_rate(fitted)[0]) * windows.interval * frames < 1


def _one_temperature(fitted: Fitted, kicks: float, field: Field, windows: Windows) -> bool:
    """Whether kicks and friction balance at about the temperature at which the bodies move.

    A friction that may be zero balances no kicks at all, and none is known better than the speeds
    that it makes forget allow: to sqrt(2 rate / time) in each coordinate.
    """
    rate, error = friction_rate(fitted)
    seen = float((windows.length[:, None] * windows.seen.mean(1)).sum()) * field.v.shape[-1]
    error = max(error, float(np.sqrt(2 * max(rate, 0.0) / seen)))
    if rate <= NORMAL_95 * error:
        return False
    kinetic = float((field.v**2 * field.mass[:, None, :, None]).mean())
    apart = abs(np.log(kicks / (2 * rate) / kinetic))
    return bool(apart < np.log(BALANCE) + 2 * error / rate)


def friction_rate(fitted: Fitted) -> tuple[float, float]:
    """The friction's number and its standard error; zeros where there is none."""
    friction = fitted.structure.term(FRICTION)
    if friction is None:
        return 0.0, 0.0
    return float(fitted.structure.of(friction)[0]), float(fitted.errors[fitted.place(friction)])


def _judged(
    excess: float,
    allowed: float,
    kicks: float,
    smooth: float,
    probes: dict[str, float],
    ratio: float,
    doubt: str,
) -> str:
    """What says that the menu does not explain the motion; empty if nothing does."""
    if probes:
        likeliest = max(probes, key=lambda name: probes[name])
        return f"what is left over looks like {likeliest}"
    if ratio and smooth > kicks:
        return "what is left over changes smoothly: a force, not random kicks"
    if doubt:
        return doubt
    if not ratio and excess > allowed:
        return f"the residual is {np.sqrt(excess):.2f} times the noise"
    return ""
