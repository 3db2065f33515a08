"""How long the units of a study will take, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vidphys.experiments.core.cell import Unit
from vidphys.experiments.costs import Costs
from vidphys.presets import Preset
from vidphys.runs.schedule import makespan

START_SECONDS = 8.0  # until a worker has imported what it needs
MINUTE, HOUR = 60.0, 3600.0


@dataclass(frozen=True)
class Forecast:
    """What units will take.

    Args:
        seconds: of each unit that something is known of, in their order.
        unknown: units of which nothing is.
        how: how many units are known in which way.
        peak_bytes: of the largest of them; 0 where no memory was looked at.
    """

    seconds: tuple[float, ...]
    unknown: int
    how: Mapping[str, int]
    peak_bytes: int

    def wall(self, workers: int) -> float:
        """Seconds until all are done."""
        return makespan(self.seconds, workers, START_SECONDS)

    def sentence(self, workers: int) -> str:
        """In words, for so many workers."""
        least = "at least " if self.unknown else ""
        known = ", ".join(f"{count} {how}" for how, count in self.how.items())
        unknown = f"; nothing is known of {self.unknown}" if self.unknown else ""
        return (
            f"{len(self.seconds) + self.unknown} units, {told_seconds(sum(self.seconds))} of work; "
            f"with {workers} worker{'s' * (workers > 1)} {least}{told_seconds(self.wall(workers))} "
            f"(unit times: {known or 'none'}{unknown})"
        )


def forecast(units: Sequence[Unit], preset: str, sizes: Preset, costs: Costs) -> Forecast:
    """What units will take, by what is known of each."""
    each = [costs.of(unit, preset, sizes) for unit in units]
    known = [found for found in each if found is not None]
    how = Counter(way for _, way in known)
    seconds = tuple(cost.seconds for cost, _ in known)
    peak = max((cost.peak_bytes for cost, _ in known), default=0)
    return Forecast(seconds, len(each) - len(known), how, peak)


def told_seconds(seconds: float) -> str:
    """In words that fit the size.

    Example:
        >>> [told_seconds(x) for x in (42.0, 420.0, 42_000.0)]
        ['42 s', '7.0 min', '11.7 h']
    """
    if seconds < 2 * MINUTE:
        return f"{seconds:.0f} s"
    if seconds < 2 * HOUR:
        return f"{seconds / MINUTE:.1f} min"
    return f"{seconds / HOUR:.1f} h"
