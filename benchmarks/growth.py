"""How time and memory grow, along one axis after the other, with fitted exponents.

Run from a checkout: ``python -m benchmarks.growth [AXIS …]``; a line of JSON for each axis. Times
are the least of three, with one thread, of the processor; of the clock where several processes
work. Memory (Linux) is what a piece of work adds to the process at most. ``python -m
benchmarks.growth --draw LINES PICTURE`` draws such lines on axes of logarithms.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.axes import AXES, Axis, Work

ROUNDS = 3
LEAST_SECONDS = 1e-3  # below which a call's own cost hides how its work grows
COLUMNS = 4  # of the picture


def _status(name: str) -> int:
    """MiB that the system counts of this process."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) // 2**10


def measured(work: Work, clock: Callable[[], float]) -> tuple[float, int]:
    """Seconds, and MiB that it adds at most."""
    work()
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # the peak counts from here
    before, seconds = _status("VmRSS"), []
    for _ in range(ROUNDS):
        began = clock()
        work()
        seconds.append(clock() - began)
    return min(seconds), _status("VmHWM") - before


def exponent(sizes: Sequence[int], seconds: Sequence[float]) -> float | None:
    """Slope of the logarithms where the work takes its time; ``None`` of less than two sizes."""
    known = [(n, s) for n, s in zip(sizes, seconds, strict=True) if s > LEAST_SECONDS]
    if len(known) < 2:
        return None
    x, y = np.log(np.asarray(known)).T
    return float(np.polyfit(x, y, 1)[0])


def _curve(
    work: Callable[[int], Work], sizes: Sequence[int], clock: Callable[[], float]
) -> dict[str, Any]:
    found = [measured(work(size), clock) for size in sizes]
    seconds, peaks = zip(*found, strict=True)
    told = {"sizes": sizes, "seconds": seconds, "added_mib": peaks}
    return {**told, "exponent": exponent(sizes, seconds)}


def line_of(name: str, axis: Axis) -> dict[str, Any]:
    """What is measured along an axis, and of its peer."""
    line = {"axis": name, **_curve(axis.work, axis.sizes, axis.clock)}
    if axis.peer is not None:
        called, work = axis.peer
        sizes = [size for size in axis.sizes if axis.most is None or size <= axis.most]
        line["peer"] = {"name": called, **_curve(work, sizes, axis.clock)}
    return line


def run(names: Sequence[str]) -> None:
    """Measure these axes, or all."""
    torch.set_num_threads(1)
    with torch.no_grad():
        for name in names or AXES:
            print(json.dumps(line_of(name, AXES[name])), flush=True)


def draw(lines: Path, picture: Path) -> None:
    """Seconds over size, ours and the peer's, a panel an axis."""
    import matplotlib.pyplot as plt

    told = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()]
    rows = -(-len(told) // COLUMNS)
    figure, panels = plt.subplots(rows, COLUMNS, figsize=(3.4 * COLUMNS, 2.8 * rows), squeeze=False)
    for panel, line in zip(panels.flat, told, strict=False):
        for curve, style in ((line, "o-"), (line.get("peer"), "s--")):
            if curve is not None:
                slope = curve["exponent"]
                name = curve.get("name", "vidphys") + ("" if slope is None else f" ({slope:.1f})")
                panel.loglog(curve["sizes"], curve["seconds"], style, label=name, markersize=3)
        panel.set_title(line["axis"], fontsize=8)
        panel.tick_params(labelsize=7)
        panel.legend(fontsize=6)
    for panel in panels.flat[len(told) :]:
        panel.axis("off")
    figure.supylabel("seconds", fontsize=9)
    figure.tight_layout()
    figure.savefig(picture)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--draw"]:
        draw(*map(Path, sys.argv[2:]))
    else:
        run(sys.argv[1:])
