"""What a piece of work took, as it stands with what it left."""

from __future__ import annotations

import json
import resource
import sys
from dataclasses import asdict, dataclass

import pyarrow as pa

COST = b"cost"  # in the metadata of a part's records


@dataclass(frozen=True)
class Cost:
    """What a piece of work took.

    Args:
        seconds: by the clock on the wall, with one core.
        peak_bytes: of memory that its process held at most; 0 where it was not looked at.
    """

    seconds: float
    peak_bytes: int = 0


def peak_memory() -> int:
    """Bytes that this process has held at most, all its work so far included."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def marked(cost: Cost | None) -> dict[bytes, bytes]:
    """As metadata of a table."""
    return {} if cost is None else {COST: json.dumps(asdict(cost)).encode()}


def cost_of(part: pa.Table) -> Cost | None:
    """What a part's records say that it took, where they do."""
    told = (part.schema.metadata or {}).get(COST)
    return None if told is None else Cost(**json.loads(told))
