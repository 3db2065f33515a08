"""A motion explained by laws that were fitted to the whole of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from vidphys.diagnose.explanations.collided import collided
from vidphys.diagnose.explanations.explanation import Explanation, Oscillation
from vidphys.diagnose.explanations.forecast import SAMPLES, State, Validation, beside_simple
from vidphys.diagnose.explanations.scene import as_scene
from vidphys.diagnose.explanations.verdict import EXPLAINED, NOT, Verdict, judge
from vidphys.diagnose.mechanisms.charts import Arc, Plane
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.mechanism import Group, Mechanism, find_mechanism
from vidphys.diagnose.mechanisms.quantities import Quantity, quantities
from vidphys.diagnose.mechanisms.rods import RodsFit
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import Noise, noise_of
from vidphys.diagnose.recordings.units import GRAVITY, Units
from vidphys.statistics import NORMAL_95

ON = {
    "plane": "moves freely",
    "line": "moves on a line",
    "angle": "swings",
    "arc": "swings on an arc",
}
BY = {
    "none": "nothing pulls it",
    "uniform": "under a constant acceleration",
    "trap": "about a place that it is pulled back to, as a spring does",
    "pendulum": "as a pendulum",
    "chain": "as two rods that hang end on end",
}
CLEAR = 4.0  # of log likelihood after its price, within which another law may be the true one
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
}


@dataclass(frozen=True)
class ByMechanism(Explanation):
    """What laws of a mechanism say of a recording.

    Args:
        mechanism: fitted to the frames before ``end``.
        whole: the same laws with numbers from all frames, those that were held out among them.
        motion: the whole recording.
        end: first frame that nothing was fitted to.
        units: in which lengths are told.
    """

    mechanism: Mechanism
    whole: Mechanism
    motion: Motion
    end: int
    units: Units

    @property
    def sure(self) -> bool:
        """Whether it explains all, and no law of other terms is nearly as likely."""
        rivals = (
            group.fit.score - other.score
            for group in self.whole.groups
            for other in group.others
            if other.kinds != group.fit.kinds
        )
        return self.explained and min(rivals, default=np.inf) > CLEAR

    @cached_property
    def told_in(self) -> Units:
        """The units; metres where gravity is known and something hangs or falls."""
        gravity = self.units.gravity
        if gravity is None:
            return self.units
        for group in self.whole.groups:
            known = {x.name: x.value for x in quantities(group.fit)}
            if "length" in known and "rate" in known:
                return Units("m", gravity / known["rate"] ** 2 / known["length"])
            if "acceleration" in known:
                return Units("m", gravity / known["acceleration"])
        return self.units

    @property
    def one_law(self) -> bool:
        return len(self.mechanism.groups) == 1

    @property
    def first(self) -> int:
        return self.mechanism.first

    @property
    def noise(self) -> Noise:
        """Of the positions, as the laws leave it."""
        sigma = max(group.fit.errors.white for group in self.mechanism.groups)
        return noise_of(sigma, self.motion)

    @classmethod
    def of(
        cls, motion: Motion, end: int, angles: bool, camera: bool, units: Units
    ) -> ByMechanism | None:
        """The laws of a recording before ``end``, if any can be fitted."""
        found = find_mechanism(motion.cut(0, end), angles, camera)
        return None if found is None else cls(*found.refitted(motion), motion, end, units)

    @property
    def kinds(self) -> list[str]:
        return sorted(self.mechanism.kinds)

    @cached_property
    def verdict(self) -> Verdict:
        found = self.mechanism
        straight = found.kinds == {"collision"}
        judged = judge(
            found.share, found.left, found.spread, self.forecast(), self._period, straight
        )
        return replace(judged, status=NOT) if self._gains else judged

    @property
    def _period(self) -> float:
        """Seconds of a swing, about: the way round a circle of the motion's size."""
        part = self.motion.cut(0, self.end)
        steps = np.linalg.norm(np.diff(part.positions, axis=1), axis=-1)
        speed = np.nanmean(steps / np.diff(part.times, axis=1)[..., None])
        return 2 * np.pi * self.mechanism.spread / max(float(speed), np.finfo(float).tiny)

    @property
    def explained(self) -> bool:
        return self.verdict.status == EXPLAINED

    @property
    def fastest(self) -> float:
        return max(
            group.fit.model.law.rate({k: v for k, (v, _) in group.fit.numbers.items()})
            for group in self.mechanism.groups
        )

    def lines(self) -> list[str]:
        out = []
        for group in self.whole.groups:
            out += self._told(group)
        out += [self._what_is_left(), *self._rivals()]
        if self._gains:
            out.append(
                "No wall gives back more speed than it takes: something else turns it round."
            )
        if self._from_below:
            out.append("No model of it is written: give the body next to the pivot first.")
        return out

    def _rivals(self) -> list[str]:
        """Laws that are nearly as likely."""
        out = []
        for group in self.whole.groups:
            near = [x for x in group.others if x.score > group.fit.score - CLEAR]
            kinds = {
                ", ".join(SHORT.get(kind, kind) for kind in sorted(x.kinds)) or "no force"
                for x in near
                if x.kinds != group.fit.kinds
            }
            if kinds:
                said = "; or ".join(sorted(kinds))
                out.append(f"Nearly as likely: {said}. A longer recording would tell.")
        return out

    def _told(self, group: Group) -> list[str]:
        fit, law = group.fit, group.fit.model.law
        named = [f"Body {b + 1}" for b in group.bodies] if self.motion.bodies > 1 else ["The body"]
        who = " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)
        moves = _where(fit) if len(named) == 1 else _plural(_where(fit))
        how = [BY[law.restoring], *(LOSES[x] for x in law.frictions)]
        if fit.driven:
            how[1] = "something drives it"
        if law.walls:
            it = "they bounce" if len(group.bodies) > 1 else "it bounces"
            how.append(f"{it} off a wall" if len(law.walls) == 1 else f"{it} off walls")
        if law.coupled:
            how.append("springs hold the bodies together")
        if "collision" in law.kinds:
            how[0] = "nothing pulls them" if law.restoring == "none" else how[0]
            how.append("they collide")
        out = [f"{who} {moves}: {'; '.join(how)}."]
        out += [f"  {x}" for x in collided(fit, group.bodies)]
        out += [f"  {self._number(x)}" for x in quantities(fit)]
        out += [f"  {x}" for x in self._ruler(fit)]
        return out

    def _number(self, x: Quantity) -> str:
        value, error = (self.told_in.told(v, x.length) for v in (x.value, NORMAL_95 * x.error))
        unit = self.told_in.named(x.length, x.seconds)
        return f"{x.name} {value:.4g} ± {error:.2g}{f' {unit}' if unit else ''} (95 %)"

    def _ruler(self, fit: Fit) -> list[str]:
        """What gravity says of lengths: a falling or a hanging body is a ruler."""
        known = {x.name: x.value for x in quantities(fit)}
        if "rate" in known and fit.model.law.restoring == "pendulum":
            metres = GRAVITY / known["rate"] ** 2
            length = f"if it hangs in {GRAVITY} m/s², it is {metres:.3g} m long"
            if "length" in known and self.told_in.name != "m":
                told = self.told_in.told(known["length"], 1)
                long = f"{told / metres:.4g} {self.told_in.name}"
                return [f"{length} (a plain pendulum), and 1 m is {long}"]
            return [f"{length} (a plain pendulum)"]
        if "acceleration" in known and self.told_in.name == "px":
            told = self.told_in.told(known["acceleration"], 1)
            return [f"if it falls at {GRAVITY} m/s², 1 m is {told / GRAVITY:.4g} px"]
        return []

    def _what_is_left(self) -> str:
        found = self.mechanism
        errors = [group.fit.errors for group in found.groups]
        worst = max(errors, key=lambda e: e.total)
        text = f"What is left is {self.told_in.length(found.left)}"
        if worst.smooth > worst.white:
            return text + (
                f", and lasts for {worst.memory:.2g} s, as a lens, perspective or a tracker's slow "
                "mistakes leave it."
            )
        return text + ", different in every frame, as noise is."

    def data(self) -> dict[str, Any]:
        told: dict[str, Any] = {"mechanism": [self._data(group) for group in self.whole.groups]}
        wall = _wall_of(self.whole.groups[0].fit) if self.motion.bodies == 1 else None
        return told if wall is None else {**told, "wall": wall}

    def _data(self, group: Group) -> dict[str, Any]:
        fit, chart = group.fit, group.fit.model.charts[0]
        held: dict[str, Any] = {
            "bodies": list(group.bodies),
            "moves on": chart.name,
            "restoring": fit.model.law.restoring,
            "friction": fit.model.law.friction,
            "walls": len(fit.model.law.walls),
            "quantities": {
                x.name: {
                    "value": self.told_in.told(x.value, x.length),
                    "standard_error": self.told_in.told(x.error, x.length),
                    "unit": self.told_in.named(x.length, x.seconds),
                }
                for x in quantities(fit)
            },
            "errors": {
                "white": self.told_in.told(fit.errors.white, 1),
                "smooth": self.told_in.told(fit.errors.smooth, 1),
                "memory_seconds": fit.errors.memory,
            },
            "log_likelihood": fit.log_likelihood,
            "others": [
                {
                    "moves on": x.model.charts[0].name,
                    "terms": sorted(x.model.law.kinds),
                    "less_likely_by": fit.score - x.score,
                }
                for x in group.others[:5]
            ],
        }
        if isinstance(chart, Arc):
            pivot = chart.pivot(fit.geometry[0])
            held["pivot"] = [self.told_in.told(float(x), 1) for x in pivot]
        return held

    def numbers(self) -> dict[str, float]:
        return {"share_explained": self.mechanism.share}

    def path(self) -> tuple[np.ndarray, np.ndarray]:
        times = self.motion.times[0]
        times = times[times >= self.mechanism.begin[0]]
        return times, self.mechanism.path(times, 0)

    def forecast(self) -> Validation | None:
        end, times = self.end, self.motion.times[-1]
        if end >= len(times) or self.motion.clips > 1:
            return None
        path = self.mechanism.path(times[end - 3 :])
        h = np.diff(times[end - 3 : end])
        v = (path[2] - path[1]) / h[1]
        a = (v - (path[1] - path[0]) / h[0]) / h.mean()
        start = State(float(times[end - 1]), path[2], v, self.motion.mass[-1])
        return beside_simple(path[3:], self.motion.cut(end), start, a)

    def oscillations(self) -> list[Oscillation]:
        return []

    def changed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Each law that may be asked for, from the last fitted frame on."""
        times = self.motion.times[-1]
        stop, last = times[min(self.end, len(times)) - 1], times[-1]
        out = {}
        for name, factor in _asked_of(self.mechanism).items():
            # What collisions do with other masses is seen from before they happen.
            again = any(key.startswith("mass") for key in factor)
            start = times[self.mechanism.first] if again else stop
            since = np.linspace(0, last - start + 0.3 * (stop - times[0]), SAMPLES)
            parts = {}
            for group in self.mechanism.groups:
                path = _under(group.fit, factor, float(start - self.mechanism.begin[-1]), since)
                parts.update({b: path[:, i] for i, b in enumerate(group.bodies)})
            out[name] = (start + since, np.stack([parts[b] for b in sorted(parts)], 1))
        return out

    @property
    def _gains(self) -> bool:
        """Whether a body leaves a wall faster than it came, surely."""
        return any(
            value > 1 + NORMAL_95 * error
            for group in self.whole.groups
            for name, (value, error) in group.fit.numbers.items()
            if name.startswith("restitution")
        )

    @property
    def _from_below(self) -> bool:
        """Whether the first of two bodies hangs from the second; a model counts from the pivot."""
        fit = self.whole.groups[0].fit
        return isinstance(fit, RodsFit) and fit.rods.order != (0, 1)

    def specification(self) -> dict[str, Any] | None:
        return (
            None
            if self._from_below
            else as_scene(self.whole, self.motion.interval, self.verdict, self.motion.space)
        )


def _where(fit: Fit) -> str:
    chart = fit.model.charts[0]
    return ON["line" if isinstance(chart, Plane) and chart.space == 1 else chart.name]


def _wall_of(fit: Fit) -> dict[str, Any] | None:
    """Across which axis the first wall stands, and where, unit of the positions."""
    law = fit.model.law
    if not law.walls:
        return None
    normal = law.walls[0].turned(fit.numbers.get("turn 1", (0.0, 0.0))[0])
    place = fit.numbers["wall 1"][0]
    on, beyond = (fit.shown(x * normal[None])[0, 0] for x in (place, 1.01 * place + 1e-6))
    axis = int(np.abs(beyond - on).argmax())
    return {"axis": "xyz"[axis], "place": float(on[axis])}


def _plural(said: str) -> str:
    verb, _, rest = said.partition(" ")
    return f"{verb.removesuffix('s')} {rest}".strip()


def _asked_of(mechanism: Mechanism) -> dict[str, dict[str, float]]:
    """What may be changed of the laws: factors by the beginning of a number's name."""
    kinds = mechanism.kinds
    asked: dict[str, dict[str, float]] = {}
    if kinds & set(LOSES):
        asked["no friction"] = {name: 0.0 for name in LOSES}
    if "pendulum" in kinds:
        asked["half the length"] = {"swing": 2.0}
    elif "trap" in kinds:
        asked["twice the stiffness"] = {"stiffness": 2.0, "force": 2.0}
    elif "uniform" in kinds:
        asked["twice the field"] = {"force": 2.0}
    if "collision" in kinds:
        asked["a second body of twice the mass"] = {"mass 2": 2.0}
    return asked


def _under(fit: Fit, factors: dict[str, float], start: float, since: np.ndarray) -> np.ndarray:
    """Places ``(t, n, d)`` under changed numbers, from the fit's own state at ``start`` seconds."""
    numbers, starts = fit.model.split(fit.values, len(fit.clips))
    state = fit.model.law.roll(numbers, starts[-1], np.array([0.0, max(start, 1e-9)]))[-1]
    changed = numbers.copy()
    for i, name in enumerate(fit.model.law.names):
        changed[i] *= next((x for key, x in factors.items() if name.startswith(key)), 1.0)
    law = replace(fit.model.law, nears=False)
    kept = [i for i, name in enumerate(fit.model.law.names) if name != "nearing"]
    rolled = law.roll(changed[kept], state, since)[:, 0]
    return fit.shown(rolled)
