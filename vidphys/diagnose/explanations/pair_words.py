"""What is said of a force between pairs of bodies: whether it pulls, and how it falls off."""

from __future__ import annotations

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import PAIR
from vidphys.diagnose.recordings.units import Units

FALLS_OFF = {  # shape of a pair force: how it goes with the distance r
    "point": "1 / r²",
    "inverse-square": "1 / r², softened within the length",
    "inverse": "1 / r, softened within the length",
    "inverse-cube": "1 / r³, softened within the length",
    "spring": "r, as a spring's does",
    "rest-length": "stiffness · r + offset, as a spring's of a rest length does",
    "lennard-jones": "attraction / r⁷ - repulsion / r¹³, as between molecules (Lennard-Jones)",
    "gaussian": "r under a bell curve as wide as the length",
}
ONE = {"point": "inverse-square"}  # shapes that differ by their length alone
WOULD_TELL = "Bodies that come nearer to each other and go farther apart would tell."
AS_LIKELY = 8.0  # of log likelihood after its price, by which another shape is worse that may hold


def pair_lines(inference: Inference, units: Units) -> list[str]:
    """How the pair force of an answer goes with the distance, if one of a known shape is there."""
    pair = inference.structure.term(PAIR)
    if pair is None or pair.shape not in FALLS_OFF:
        return []
    others = other_shapes(inference)
    numbers = inference.structure.of(pair).tolist()
    how = "attract" if numbers[0] > 0 else "repel"
    told = f"they {how} each other"
    if pair.shape == "lennard-jones":
        told = "they repel each other when near, and attract each other farther off"
    lines = [f"{told}; the force goes with {FALLS_OFF[pair.shape]}"]
    if pair.shape == "lennard-jones":
        lines.append(_usual_form(numbers[0], numbers[1], units))
    if others:
        like = "; or ".join(FALLS_OFF[shape] for shape in others)
        lines.append(f"as likely with {like}. {WOULD_TELL}")
    return lines


def _usual_form(repulsion: float, attraction: float, units: Units) -> str:
    """Lennard-Jones's force by what it is known by: the distance of no energy, and the depth."""
    sixth = repulsion / (2 * attraction)
    sigma, depth = units.told(sixth ** (1 / 6), 1), units.told(attraction / (24 * sixth), 2)
    long, deep = (
        f"{x:.4g} {unit}".rstrip()
        for x, unit in ((sigma, units.named(1, 0)), (depth, units.named(2, -2)))
    )
    return f"sigma {long}, epsilon {deep} (of masses one)"


def other_shapes(inference: Inference) -> list[str]:
    """Other shapes with which the same kinds of terms are nearly as likely, the likeliest first."""
    if not inference.structures:
        return []
    best = inference.structures[0]
    known = [inference.structure.term(PAIR)]
    for each in inference.structures:
        pair = each.term(PAIR)
        alike = each.kinds == best.kinds and each.score > best.score - AS_LIKELY
        if alike and pair is not None and pair.shape in FALLS_OFF:
            known.append(pair)
    shapes = [ONE.get(pair.shape, pair.shape) for pair in known if pair is not None]
    return list(dict.fromkeys(shapes))[1:]
