"""A body that keeps to a curve under a steady force, as on a ramp, in a bowl or through a loop."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from vidphys.diagnose.mechanisms.charts import Bound
from vidphys.diagnose.mechanisms.curve import Curve, curve_through
from vidphys.diagnose.mechanisms.fit import race
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import Local, halves, joined, seen_in, start_of

FLAT = 2  # dimensions of the plane
BENT = 0.3  # radians from end to end, below which a curve is a line
VAGUE = 0.15  # of the force: a standard error from which it is not told
LIKELIER = 10.0  # of log likelihood after its price, than a usual law
NEARER = 0.5  # times what a usual law leaves along the curve: what is left at most
LENS = 0.02  # of the spread, by which a lens bends a curve at most
ACROSS = np.array([[0.0, -1.0], [1.0, 0.0]])  # turns a tangent's component to the normal's
PRESSED = 0.3  # of the force, that presses a body to its curve at least
AGAIN = 1.1  # times a curve's length, that a way along it is long at most which passes it once
FRICTIONS = ("none", "linear", "square", "dry")


def curved(clips: Sequence[Frames], usual: Sequence[Fit] = ()) -> list[Fit]:
    """Laws of a body that a steady force pulls along the curve that all of its places draw.

    Args:
        clips: of the body.
        usual: other laws of it, which may as well be the true ones.
    """
    places = [clip.stretches[0].places for clip in clips]
    if places[0].shape[1] != FLAT or clips[0].inputs is not None:
        return []
    each = zip(places, clips, strict=True)
    drawn = [p if clip.ahead is None else np.concatenate([p, clip.ahead]) for p, clip in each]
    curve = curve_through(drawn)
    if curve is None or curve.turn < BENT:
        return []
    along = [curve.read(p)[:, None] for p in places]
    seen = [seen_in(clips, along, half) for half in halves(clips)]
    runners = []
    for friction, upright in product(FRICTIONS, (True, False)):
        law = Law(1, "uniform", friction, curve=curve, upright=upright)
        runners.append((Model(law, (Bound(curve),)), [_begun(one, law, curve) for one in seen]))
    told = [x for x in race(clips, runners) if _told(x)]
    return [x for x in told if all(_keeps_to_it(x, one) for one in usual)]


def _keeps_to_it(found: Fit, usual: Fit) -> bool:
    """Whether a usual law is far less likely, and misses the curve by more than a lens bends it, or
    far more along it.

    A curve that all places draw leaves nothing across it, whatever moves the body.
    """
    curve = found.model.law.curve
    assert curve is not None
    if found.score < usual.score + LIKELIER:
        return False
    rows = [curve.row(curve.read(clip.stretches[0].places)) for clip in found.clips]
    tangents = curve.tangents[np.concatenate(rows)]
    own, other = (np.concatenate(x.residuals) for x in (found, usual))
    across = np.sqrt(np.mean((other @ ACROSS * tangents).sum(1) ** 2))
    along, left = (np.linalg.norm((x * tangents).sum(1)) for x in (other, own))
    return bool(across > LENS * found.spread or left < NEARER * along)


def _begun(seen: Sequence[Local], law: Law, curve: Curve) -> np.ndarray:
    """The law's numbers by least squares, and the starts."""
    s, v, a = (x.ravel() for x in joined(seen, "sva"))
    x, y, _ = curve.table[curve.row(s)].T
    pulls = y[:, None] if law.upright else np.column_stack([x, y])
    *level, up = np.linalg.lstsq(pulls, a, rcond=None)[0]
    pressed = _pressed(curve, s, v, sum(level), up)
    lost = {"none": [], "linear": [v], "square": [np.abs(v) * v], "dry": [pressed * np.sign(v)]}
    design = np.column_stack([pulls, *(-x for x in lost[law.friction])])
    return np.concatenate([np.linalg.lstsq(design, a, rcond=None)[0], *map(start_of, seen)])


def _told(found: Fit) -> bool:
    """Whether the recording tells the force, and that the curve presses: what flies needs none."""
    law = found.model.law
    forces = [found.numbers[name] for name in law.forces]
    size = float(np.linalg.norm([value for value, _ in forces]))
    if max(error for _, error in forces) >= VAGUE * size:
        return False
    assert law.curve is not None
    level, up = ([0.0] * law.upright + [value for value, _ in forces])[:FLAT]
    s, v = np.concatenate(found.model.coordinates(found.values, found.clips))[..., 0].T
    return bool(np.median(_pressed(law.curve, s, v, level, up)) > PRESSED * size)


def _pressed(curve: Curve, s: np.ndarray, v: np.ndarray, level: float, up: float) -> np.ndarray:
    """What presses a body to the curve, at lengths and their rates ``(t,)``, under a force."""
    x, y, bend = curve.table[curve.row(s)].T
    return np.abs(bend * v**2 + level * y - up * x)


def once(found: Fit) -> bool:
    """Whether a body passes its curve once, as what flies and is pushed across its way does too."""
    if found.model.law.curve is None:
        return False
    ways = [r[:, 0, 0] for r in found.model.coordinates(found.values, found.clips)]
    return all(bool(np.abs(np.diff(s)).sum() < AGAIN * np.ptp(s)) for s in ways)
