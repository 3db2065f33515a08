"""How long the units of a study will take, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vidphys.experiments.core.cell import Unit
from vidphys.experiments.costs import Cost, Costs
from vidphys.presets import Preset
from vidphys.runs.engine import EngineName
from vidphys.runs.schedule import makespan

# Of a command and its engine: imports, its processes, its report. The pace of training says little
# of them: they took as long on a machine that trained half as fast. How long jobs wait is unknown.
START_SECONDS: dict[EngineName, float] = {"local": 24.0, "ray": 42.0, "submitit": 24.0}
MINUTE, HOUR = 60.0, 3600.0


@dataclass(frozen=True)
class Forecast:
    """What units will take.

    Args:
        units: what each costs and how that is known, or ``None`` where nothing is known.
        engine: that runs them.
        pace: of this machine, see :func:`vidphys.experiments.costs.pace_here`.
    """

    units: Mapping[Unit, tuple[Cost, str] | None]
    engine: EngineName = "local"
    pace: float = 1.0

    @property
    def known(self) -> list[tuple[Cost, str]]:
        """Of the units that something is known of."""
        return [found for found in self.units.values() if found is not None]

    @property
    def seconds(self) -> list[float]:
        """Of each of these, in their order."""
        return [cost.seconds for cost, _ in self.known]

    @property
    def unknown(self) -> int:
        """How many units nothing is known of."""
        return len(self.units) - len(self.known)

    @property
    def peak_bytes(self) -> int:
        """Of the largest unit; 0 where no memory was looked at."""
        return max((cost.peak_bytes for cost, _ in self.known), default=0)

    def wall(self, workers: int) -> float:
        """Seconds until all are done."""
        return makespan(self.seconds, workers, START_SECONDS[self.engine])

    def sentence(self, workers: int) -> str:
        """In words, for so many workers."""
        least = "at least " if self.unknown else ""
        ways = Counter(how for _, how in self.known)
        known = ", ".join(f"{count} {how}" for how, count in ways.items())
        unknown = f"; nothing is known of {self.unknown}" if self.unknown else ""
        return (
            f"{len(self.units)} units, {told_seconds(sum(self.seconds))} of work; "
            f"with {workers} worker{'s' * (workers > 1)} {least}{told_seconds(self.wall(workers))} "
            f"(unit times: {known or 'none'}{unknown}; those that come with vidphys times "
            f"{self.pace:.2g}, by a measure of this machine)"
        )


def forecast(
    units: Sequence[Unit],
    preset: str,
    sizes: Preset,
    costs: Costs,
    engine: EngineName = "local",
    pace: float = 1.0,
) -> Forecast:
    """What units will take, by what is known of each."""
    return Forecast({unit: costs.of(unit, preset, sizes) for unit in units}, engine, pace)


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
