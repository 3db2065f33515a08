"""Springs between bodies that each have a trap or a swing of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from vidphys.diagnose.mechanisms.charts import Angle, Arc, Chart
from vidphys.diagnose.mechanisms.choose import pictured
from vidphys.diagnose.mechanisms.fit import fit, race, without_friction
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.ranking import ranked
from vidphys.diagnose.mechanisms.sense import makes_sense
from vidphys.diagnose.mechanisms.starts.guesses import guesses
from vidphys.statistics import NORMAL_95

# of log likelihood after its price, by which one law must beat a law for each, and what pushes
# bodies apart what holds them together
CLEARLY = 20.0
PULLS = (0.03, 0.1, 0.3, 1.0)  # of the stiffness, that couplings begin at


def coupled(
    clips: Sequence[Frames], laws: Sequence[Sequence[Fit]], camera: bool = False
) -> list[Fit]:
    """Laws of all bodies, best first, if the evidence for one is clearer than for a law of each.

    They differ in their friction.

    Args:
        clips: of all bodies.
        laws: of each body alone, best first; those of them count that pull it back along one way.
        camera: whether the places are in a picture.
    """
    runners = []
    for restoring in ("trap", "pendulum"):
        alike = _pulled(restoring)
        each = [next((x for x in fits if alike(x.model.law)), None) for fits in laws]
        one = next((x for x in each if x is not None), None)
        if one is None:
            continue
        # A body that another one pulls may move by no such law alone.
        each = [x or _like(clips, body, one) for body, x in enumerate(each)]
        known = [x for x in each if x is not None]
        if len(known) < len(laws):
            continue
        charts = tuple(x.model.charts[0] for x in known)
        hung = _hung(charts, [x.geometry[0] for x in known])
        law = Law(len(known), restoring, "linear", apart=True, coupled=True, hung=hung)
        for ties in ((), _row(clips)) if len(known) > 2 else ((),):
            model = Model(replace(law, ties=ties), charts)
            runners += [(model, [guess]) for guess in _guesses(law, known, len(clips))]
    best = max(race(clips, runners), key=_usual, default=None) if runners else None
    if best is None:
        return []
    best = _loosened(clips, _rehung(clips, best))
    best = pictured(clips, best) if camera else best
    likely = ranked([x for x in (best, without_friction(clips, best)) if x and makes_sense(x)])
    alone = sum(fits[0].score for fits in laws)
    return likely if likely and likely[0].score > alone + CLEARLY else []


def _row(clips: Sequence[Frames]) -> tuple[tuple[int, int], ...]:
    """Neighbours along the way on which bodies lie farthest apart."""
    middles = np.array([stretch.places.mean(0) for stretch in clips[0].stretches])
    order = np.argsort(middles[:, np.ptp(middles, axis=0).argmax()]).tolist()
    return tuple((min(pair), max(pair)) for pair in pairwise(order))


def _like(clips: Sequence[Frames], body: int, other: Fit) -> Fit | None:
    """A law of one body by itself, of the kind of another's, and on as long a string."""
    alone = [clip.of(body) for clip in clips]
    chart, geometry = other.model.charts[0], other.geometry[0]
    string = chart.vectors(geometry)[2] if isinstance(chart, Arc) else None
    alike = _pulled(other.model.law.restoring)
    started = guesses(alone, isinstance(chart, Angle), string)
    runners = [(x.model, x.values) for x in started if alike(x.model.law)]
    return max(race(alone, runners), key=lambda x: x.score, default=None) if runners else None


def _usual(found: Fit) -> float:
    """How likely it is; what pushes bodies apart is rarer than what holds them together."""
    pulls = (v for name, (v, _) in found.numbers.items() if name.startswith("coupling"))
    return found.score - (CLEARLY if min(pulls) < 0 else 0.0)


def _hung(charts: Sequence[Chart], geometry: Sequence[np.ndarray]) -> tuple[float, ...]:
    """Where bodies on arcs hang along a level line, over their length; empty for other bodies."""
    arcs = [(c, g) for c, g in zip(charts, geometry, strict=True) if isinstance(c, Arc)]
    if len(arcs) < len(charts):
        return ()
    length = float(np.mean([chart.length(g) for chart, g in arcs]))
    return tuple(float(chart.pivot(g)[0]) / length for chart, g in arcs)


def _rehung(clips: Sequence[Frames], found: Fit) -> Fit:
    """The same law of bodies that hang where it says, which their own laws do not."""
    law, charts = found.model.law, found.model.charts
    again = Model(replace(law, hung=_hung(charts, found.geometry)), charts)
    return (fit(clips, again, found.values) if law.hung else None) or found


def _loosened(clips: Sequence[Frames], found: Fit) -> Fit:
    """The same law without the traps that are not told: such bodies hang on the springs between
    them alone, as the second of two in a row.
    """
    law, told = found.model.law, found.numbers
    traps = [f"stiffness {i + 1}" for i in range(law.coordinates)]
    loose = [i for i, name in enumerate(traps) if name in told and not _sure(*told[name])]
    if not loose or len(loose) == law.coordinates:
        return found
    without = Model(replace(law, loose=tuple(loose)), found.model.charts)
    at = [law.names.index(traps[i]) for i in loose]
    return fit(clips, without, np.delete(found.values, at)) or found


def _sure(value: float, error: float) -> bool:
    return value > NORMAL_95 * error


def _pulled(restoring: str) -> Callable[[Law], bool]:
    def holds(law: Law) -> bool:
        return law.restoring == restoring and law.coordinates == 1 and not law.walls

    return holds


def _guesses(law: Law, each: Sequence[Fit], clips: int) -> list[np.ndarray]:
    """From the bodies' own laws, with couplings of several strengths."""
    known = [{name: value for name, (value, _) in x.numbers.items()} for x in each]
    own = "stiffness" if law.restoring == "trap" else "swing"
    starts = [x.model.split(x.values, clips)[1] for x in each]
    start = np.concatenate(starts, -1).ravel()
    stiff = float(np.mean([k[own] for k in known]))
    out = []
    for share in PULLS:
        numbers = {f"{own} {i + 1}": k[own] / (1 + share) for i, k in enumerate(known)}
        numbers |= {f"force {i + 1}": k.get("force 1", 0.0) for i, k in enumerate(known)}
        numbers |= {f"coupling {i + 1}": share * stiff for i in range(len(known))}
        numbers["linear"] = float(np.mean([k.get("linear", 0.0) for k in known]))
        out.append(np.concatenate([[numbers[name] for name in law.names], start]))
    return out
