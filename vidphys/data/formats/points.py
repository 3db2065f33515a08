"""Names of points and vectors: ``ax, ay, bx, by`` and ``rx, ry``, which elsewhere are rates."""

from __future__ import annotations

import re
from collections.abc import Mapping

from vidphys.data.formats.names import LENGTHS, PIXELS, Meaning, split_unit

VECTOR = r"(?:(?P<body>.*?)[\s_.]+)?{}(?P<axis>[xyz])_?(?P<number>\d*)"
POINTS = (set("abc"), set("αβγ"), {"alpha", "beta", "gamma"}, {f"p{k}" for k in range(10)})
POINT = re.compile(rf"(?P<body>{'|'.join(set.union(*POINTS))})[\s_.]?(?P<axis>[xyz])(?P<number>)")
BRACKETS = re.compile(r"\s*[\[({].*")  # a unit


def by_vectors(meanings: Mapping[str, Meaning]) -> dict[str, Meaning]:
    """Places where nothing else is one: ``ax, ay, bx, by`` of points, or ``rx, ry`` of a vector.

    Beside places, ax is an acceleration, rx a rotation and px a momentum.
    """
    bare = {name: BRACKETS.sub("", name).strip().lower() for name in meanings if _length(name)}
    places = [name for name, means in meanings.items() if means.kind == "place"]
    points = {name: POINT.fullmatch(text) for name, text in bare.items()}
    labels = {part["body"] for part in points.values() if part is not None}
    if all(map(points.get, places)) and len(labels) > 1 and any(labels <= own for own in POINTS):
        return _placed(meanings, points)
    for letter in "" if places else "qrp":
        vectors = {n: re.fullmatch(VECTOR.format(letter), text) for n, text in bare.items()}
        if any(vectors.values()):
            return _placed(meanings, vectors)
    return dict(meanings)


def _length(name: str) -> bool:
    """Whether a name says no unit, or that of a length."""
    return split_unit(name)[1] in ("", *LENGTHS, *PIXELS)


def _placed(
    meanings: Mapping[str, Meaning], parts: Mapping[str, re.Match[str] | None]
) -> dict[str, Meaning]:
    """With the columns whose names have a body and an axis as places."""
    out = dict(meanings)
    for name, part in parts.items():
        if part is not None:
            body = f"{part['body'] or ''} {part['number'] or ''}".strip()
            unit = meanings[name].unit if BRACKETS.search(name) else ""
            out[name] = Meaning("place", part["axis"], body, unit)
    return out
