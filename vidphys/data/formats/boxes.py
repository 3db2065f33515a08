"""Boxes around bodies, as detectors write them: their middles are the places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

EDGES = (
    ("xmin", "ymin", "xmax", "ymax"),
    ("left", "top", "right", "bottom"),
)
SIDES = (
    ("left", "top", "width", "height"),
    ("xmin", "ymin", "width", "height"),
    ("xmin", "ymin", "w", "h"),
)
BEFORE = ("bbox", "box", "bb")  # what may stand before these names
MOT = ("frame", "id", "left", "top", "width", "height", "conf")  # then -1, as MOTChallenge has them
MOT_REST = 2  # columns of -1 at least


def centred(table: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """A table with ``u`` and ``v`` where it has the edges of a box, or two of them and its sides.

    Args:
        table: columns of numbers or words, ``(rows,)``, by name.

    Returns:
        The table, and what was done, a line each.

    Example:
        >>> box = dict(x_min=np.array([1.0]), y_min=np.array([2.0]))
        >>> box |= dict(x_max=np.array([5.0]), y_max=np.array([4.0]))
        >>> centred(box)[0]
        {'u': array([3.]), 'v': array([3.])}
    """
    plain = {_plain(name): name for name in table}
    for names, sides in [(n, False) for n in EDGES] + [(n, True) for n in SIDES]:
        if not set(names) <= set(plain) or any(
            table[plain[n]].dtype.kind not in "fiu" for n in names
        ):
            continue
        a, b, c, d = (np.asarray(table[plain[n]], float) for n in names)
        middle = (a + c / 2, b + d / 2) if sides else ((a + c) / 2, (b + d) / 2)
        rest = {name: x for name, x in table.items() if name not in [plain[n] for n in names]}
        used = ", ".join(plain[n] for n in names)
        return {**rest, "u": middle[0], "v": middle[1]}, (f"the middle of boxes {used}",)
    return dict(table), ()


def _plain(name: str) -> str:
    bare = "".join(c for c in name.lower() if c.isalnum())
    return next((bare.removeprefix(word) for word in BEFORE if bare.startswith(word)), bare)


def is_mot(columns: list[np.ndarray]) -> bool:
    """Whether columns without names are MOTChallenge's: frame, track, box, how sure, then -1."""
    if len(columns) < len(MOT) + MOT_REST or any(x.dtype.kind not in "fiu" for x in columns):
        return False
    frame, track, _, _, wide, high, _, *rest = columns
    whole = all((x == np.round(x)).all() for x in (frame, track))
    return (
        whole and bool((wide > 0).all() and (high > 0).all()) and all((x == -1).all() for x in rest)
    )
