"""Settings of a run: which are of one and the same, and what they are once it has grown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from vidphys.runs.asked import ASKED, asked_of, with_asked

GROWING = ("cells", "seeds")  # lists
NAMED = ("rungs", "sources")  # tables: the settings of each rung, where a foreign part is from


def are_of_one_run(old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    """Whether two settings are of one run, as JSON gives them back: tuples and lists are equal."""
    old, new = json.loads(json.dumps([old, new]))
    for key in NAMED:
        was, now = old.get(key, {}), new.get(key, {})
        if any(was[name] != now[name] for name in was.keys() & now):
            return False
    kept = (
        {k: v for k, v in each.items() if k not in (*GROWING, *NAMED, ASKED)} for each in (old, new)
    )
    return next(kept) == next(kept)


def extended(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """A run's settings with more cells, seeds, rungs and sources."""
    out = {**old, **{key: sorted({*old[key], *new[key]}) for key in GROWING}}
    if ASKED in new:
        out[ASKED] = with_asked(asked_of(old), new[ASKED])
    for key in (key for key in NAMED if key in new):
        out[key] = {**old.get(key, {}), **new[key]}
    return out
