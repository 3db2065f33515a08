"""What units of a study take: measured in earlier runs, or in ours, and scaled to other sizes."""

from __future__ import annotations

import tomllib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean, median
from typing import Any

from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.cell import OfRung, Unit
from vidphys.experiments.core.members import PROBE
from vidphys.experiments.pace import step_seconds
from vidphys.perception.catalogue import ORACLES
from vidphys.presets import PRESETS, OracleSizes, PixelSizes, Preset
from vidphys.runs.cost import Cost, cost_of
from vidphys.runs.folder import RunFolder

OURS = Path(__file__).with_name("costs.toml")
MEASURED, SCALED, GUESSED = "measured", "scaled", "as others of its table"
CPU = "cpu"


@dataclass(frozen=True)
class Costs:
    """What cells took.

    Args:
        known: by preset, and by ``TABLE/CELL``: of one seed.
    """

    known: Mapping[str, Mapping[str, Cost]] = field(default_factory=dict)

    @classmethod
    def ours(cls, pace: float = 1.0) -> Costs:
        """Those that come with vidphys, on one core: all of quick, some of standard.

        Args:
            pace: see :func:`pace_here`.
        """
        read = _ours()
        return cls(
            {
                preset: {
                    f"{table}/{cell}": Cost(seconds * pace)
                    for table, cells in tables.items()
                    for cell, seconds in cells.items()
                }
                for preset, tables in read.items()
                if preset in PRESETS
            }
        )

    @classmethod
    def of_runs(cls, folders: Sequence[Path], device: str = CPU) -> Costs:
        """Those of earlier runs on a kind of device; of several, the later folder counts.

        Raises:
            InputError: a folder is no run.
        """
        known: dict[str, dict[str, Cost]] = {}
        for folder in folders:
            run, took = RunFolder(folder), defaultdict[str, list[Cost]](list)
            preset = run.manifest()["settings"].get("preset", "")
            cells = run.manifest()["settings"]["cells"]
            for part in run.parts():
                cost, row = cost_of(part), part.slice(0, 1).to_pylist()
                if cost is None or not row or row[0]["device"].split()[0] != device:
                    continue
                seconds = cost.seconds / len(set(part["seed"].to_pylist()))
                name = _asked(f"{row[0]['experiment']}/{row[0]['cell']}", cells)
                took[name].append(Cost(seconds, cost.peak_bytes))
            known.setdefault(preset, {}).update({name: _usual(each) for name, each in took.items()})
        return cls(known)

    def or_else(self, other: Costs) -> Costs:
        """These, and of the other's what is not among them."""
        names = dict.fromkeys((*self.known, *other.known))
        return Costs({n: {**other.known.get(n, {}), **self.known.get(n, {})} for n in names})

    def of(self, unit: Unit, preset: str, sizes: Preset) -> tuple[Cost, str] | None:
        """What a unit takes, and how that is known; ``None`` where it is not.

        Args:
            unit: cells and seeds.
            preset, sizes: of the study.
        """
        parts = [self._cell(unit.table, cell, preset, sizes) for cell in unit.cells]
        found = [part for part in parts if part is not None]
        if len(found) < len(parts):
            return None
        worst = max((how for _, how in found), key=(MEASURED, SCALED, GUESSED).index)
        seconds = sum(cost.seconds for cost, _ in found) * len(unit.seeds)
        return Cost(seconds, max(cost.peak_bytes for cost, _ in found)), worst

    def _cell(self, table: str, cell: str, preset: str, sizes: Preset) -> tuple[Cost, str] | None:
        name = f"{table}/{cell}"
        if name in self.known.get(preset, {}):
            return self.known[preset][name], MEASURED
        for other, cells in self.known.items():
            if name in cells and other in PRESETS:
                return _times(cells[name], self._growth(other, preset, sizes, name)), SCALED
        alike = [
            _times(cost, self._growth(other, preset, sizes, key))
            for other, cells in self.known.items()
            if other in PRESETS
            for key, cost in cells.items()
            if key.startswith(f"{table}/")
        ]
        if not alike:
            return None
        return Cost(median(cost.seconds for cost in alike)), GUESSED

    def _growth(self, old: str, new: str, sizes: Preset, name: str) -> float:
        """How many times more a cell takes: by cells of its table known at both, else by sizes."""
        table, before, after = name.partition("/")[0], self.known[old], self.known.get(new, {})
        both = [key for key in before if key in after and key.startswith(f"{table}/")]
        seen = [
            after[key].seconds / before[key].seconds for key in both if _sees(key) == _sees(name)
        ]
        return median(seen) if seen else growth(PRESETS[old], sizes, _sees(name))


def known_costs(folders: Sequence[Path] = (), device: str = CPU, pace: float = 1.0) -> Costs:
    """What is known for a kind of device: from these runs, else ours, which are of the CPU.

    Args:
        folders: of runs.
        device: its kind.
        pace: of this machine, by which our times are multiplied and those of the runs are not.
    """
    found = Costs.of_runs(folders, device)
    return found.or_else(Costs.ours(pace)) if device == CPU else found


def pace_here(workers: int) -> float:
    """How many times as long as the machine of our times this one takes now, by half a second.

    Args:
        workers: that will share this machine.
    """
    return step_seconds(workers) / step_seconds_of_ours()


def step_seconds_of_ours() -> float:
    """Of the machine of our times, what :func:`step_seconds` measures here."""
    return _ours()["step_seconds"]


def _ours() -> dict[str, Any]:
    return tomllib.loads(OURS.read_text(encoding="utf-8"))


def _asked(name: str, cells: Sequence[str]) -> str:
    """The cell that was asked for, of which this one is a part."""
    return max((c for c in cells if f"{name}/".startswith(f"{c}/")), key=len, default=name)


def _usual(costs: Sequence[Cost]) -> Cost:
    """The mean of several seeds' seconds, and the most memory."""
    return Cost(fmean(cost.seconds for cost in costs), max(cost.peak_bytes for cost in costs))


def _times(cost: Cost, factor: float) -> Cost:
    return Cost(cost.seconds * factor, cost.peak_bytes)


def _sees(name: str) -> bool:
    """Whether a cell ``TABLE/CELL`` draws and sees pictures."""
    table, _, cell = name.partition("/")
    made = TABLES[table].cells.get(cell) if table in TABLES else None
    if isinstance(made, OfRung):
        return made.grounding not in ORACLES
    return table in TABLES and TABLES[table].pixels


def growth(old: Preset, new: Preset, pixels: bool) -> float:
    """How many times the work of a seed grows from one preset to another, roughly at most.

    It is that of the part of the work that grows most: where most of a cell's time goes to parts
    that grow less, it takes less.

    Args:
        old, new: sizes.
        pixels: whether pictures are drawn and seen.

    Example:
        >>> growth(PRESETS["quick"], PRESETS["paper"], pixels=False)  # mostly of training
        21.666666666666668
    """
    if pixels:
        both = [_pixel_work(sizes.pixel) for sizes in (old, new)]
    else:
        both = [_work(sizes.oracle) for sizes in (old, new)]
    return max(both[1][part] / both[0][part] for part in both[0])


def _work(sizes: OracleSizes) -> dict[str, float]:
    rates = len(sizes.learning_rates)
    tried = 1 + PROBE * rates * (rates > 1)
    return {
        "trajectories": sizes.trajectories,
        "training": sizes.steps * sizes.batch * tried,
        "scoring": sizes.held_out,
    }


def _pixel_work(sizes: PixelSizes) -> dict[str, float]:
    pixels = sizes.image**2
    return {
        "drawing": (sizes.clips + sizes.encounters) * sizes.frames * pixels,
        "perception": sizes.perception_steps * sizes.perception_batch * pixels,
        "tracks": sizes.track_steps,
        "looking": sizes.held_out * sizes.frames * pixels,
    }
