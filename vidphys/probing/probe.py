"""``vidphys.probe``: what an encoder knows of targets, layer by layer, beside all controls."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from registry import unknown
from vidphys.data.splits import AUTO
from vidphys.data.video import ClipSelection
from vidphys.probing.controls import CONTROLS, PIXELS, POOLED, RANDOM
from vidphys.probing.examples import GRID, PLAIN, VIEWS, View, patches
from vidphys.probing.files import Files
from vidphys.probing.findings import Asked, Finding, findings_of
from vidphys.probing.forms import pooled
from vidphys.probing.known import Known
from vidphys.probing.layers import AllLayers, Maps, all_layers, untrained_of
from vidphys.probing.readouts import (
    ATTENTION,
    LINEAR,
    LOCAL,
    READOUTS,
    TWO_STAGE,
    Linear,
    Local,
    Readout,
)
from vidphys.probing.scores import Sums
from vidphys.probing.shown import Arrays, Shown
from vidphys.probing.targets import Labels
from vidphys.probing.trained import Attention
from vidphys.probing.two_stage import LEAST, TwoStage

FOLDS = 5


@dataclass(frozen=True)
class Probed:
    """What an encoder knows.

    Args:
        findings: of each layer and target.
        skipped: why there is no finding, by target.
        absent: why a control could not be had, by its name.

    Example:
        >>> import numpy as np, torch
        >>> frames = torch.rand(20, 4, 3, 8, 8, generator=torch.Generator().manual_seed(0))
        >>> red = frames[:, :, 0].mean((-2, -1))
        >>> found = probe(lambda x: x.mean((-2, -1)), frames, {"red": red})
        >>> found.best("red").score.value > 0.99, found.absent
        (True, {'random-weights': 'give `untrained`: the encoder before any training'})
    """

    findings: tuple[Finding, ...]
    skipped: Mapping[str, str]
    absent: Mapping[str, str]

    def best(self, target: str) -> Finding:
        """Of the layer that knows most of a target.

        Raises:
            UnknownName: it was not asked for, or skipped.
        """
        mine = [finding for finding in self.findings if finding.target.name == target]
        if not mine:
            raise unknown("target", target, {f.target.name for f in self.findings})
        return max(mine, key=lambda finding: finding.score.value)

    def __str__(self) -> str:
        """A table: each layer and target, how it is read, its score, and all controls."""
        names = [name for name in CONTROLS if any(name in f.controls for f in self.findings)]
        rows = [["target", "layer", "form", "score", "selectivity", *names]]
        for finding in sorted(self.findings, key=lambda f: (f.target.name, f.depth)):
            controls = [
                f"{finding.controls[name].value:.2f}" if name in finding.controls else ""
                for name in names
            ]
            about = [finding.target.name, finding.layer, finding.form, str(finding.score)]
            rows.append([*about, str(finding.selectivity), *controls])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        notes = [f"{name}: {why}" for name, why in {**self.skipped, **self.absent}.items()]
        return "\n".join([*lines, *notes])


def probe(
    encoder: Any,
    clips: Path | str | Tensor | np.ndarray,
    targets: Sequence[str] | Mapping[str, Any] = (),
    *,
    untrained: Any = None,
    readout: str = LINEAR,
    widths: tuple[int, ...] = Attention.widths,
    rates: tuple[float, ...] = Attention.rates,
    each: int = 2,
    grid: int = GRID,
    folds: int = FOLDS,
    seed: int = 0,
    columns: Mapping[str, str] | None = None,
    split_by: str | Sequence[Hashable] = AUTO,
    resample: float | None = None,
) -> Probed:
    """What the layers of an encoder know of targets, with every control.

    Every clip is predicted by a readout that has not seen it, nor any other of its group. Intervals
    are of 95 %, by clip or group.

    Args:
        encoder: a frozen encoder, or anything that takes frames ``(b, t, 3, H, W)`` in [0, 1] and
            gives features ``(b, t, c, h, w)``, ``(b, t, c)`` or ``(b, c)``, or a mapping of such
            layers in order of depth. ``t`` may be smaller than the clip's.
        clips: frames ``(clips, t, 3, H, W)``, bytes or floats in [0, 1]; or the path of a folder of
            clips with a table beside each, or of a data set; see
            :func:`vidphys.data.dataset.find_dataset`.
        targets: of a path, names (see :data:`TARGETS`; ``column:``, ``angle:`` or ``class:`` and
            the name of a column), all that can be had if none is named; of frames, values by name:
            ``(clips,)``, ``(clips, t)`` or ``(clips, t, k)``. Integers and words are classes, a
            name ``angle:...`` is of radians.
        untrained: the encoder before any training; of a module its weights drawn anew, if none is
            given.
        readout: ``linear``, which takes all cells, their mean or where each channel speaks,
            whichever does best on clips left out; one of these, ``cells``, ``pooled``, ``softmax``;
            ``attention``, trained over the cells, which is slow; and for folders ``two-stage``,
            from the track of the positions that are read, or ``local``, of what lies at each
            body's true place.
        widths, rates: that ``attention`` tries side by side; what is best on clips held out of its
            training is taken.
        each: frames of each clip that are read, evenly spread.
        grid: cells on a side that maps are pooled to at most.
        folds: in which all clips are tested.
        seed: of folds, random weights and draws.
        columns: of a path, the name of a column of its tables by what it is (``{"u1": "left"}``),
            where names do not tell.
        split_by: what stays together in the folds: of a path, the name of a fact of its clips; of
            frames, a value for each clip. A clip that would be in two folds is an error.
        resample: of a path, take the frames nearest to so many a second.

    Raises:
        ValueError: arrays of wrong shapes.
        InputError: clips or tables that cannot be read, too few clips, the same clip in two folds,
            or nothing that can be learned.
    """
    layers = all_layers(encoder)
    if isinstance(clips, str | Path):
        shown = _files(clips, targets, each, columns, split_by, resample)
    else:
        shown = _arrays(clips, targets, each, columns, split_by, resample)
    known = shown.known(() if isinstance(targets, Mapping) else tuple(targets))
    known.require(folds)
    how, labels = readout_of(readout, known, each, Attention(widths, rates))
    asked = Asked(labels, np.arange(shown.count).repeat(each), known.groups, seed, folds, how)
    before = untrained_of(encoder, untrained, seed)
    views = views_of(shown, layers, before, grid)
    pixels = asked.sums(asked.read(pixels_of(shown)))
    found = layer_findings(views, pixels, asked, tuple(views[PLAIN]))
    why = {} if before else {RANDOM: "give `untrained`: the encoder before any training"}
    return Probed(tuple(found), known.left_out, why)


def layer_findings(
    views: Mapping[str, Maps], pixels: Sequence[Sums], asked: Asked, every: Sequence[str]
) -> Iterator[Finding]:
    """Findings of every layer and target.

    Args:
        views: the maps of all layers by control that needs other ones; those of the clips as they
            are under :data:`PLAIN`.
        pixels: errors of what reads the pixels.
        asked: what is read.
        every: layer of the encoder, in order of depth, also those that are not read.
    """
    for layer, maps in views[PLAIN].items():
        others = {name: view[layer] for name, view in views.items() if name and layer in view}
        depth = every.index(layer) / max(1, len(every) - 1)
        others[POOLED] = pooled(maps)
        yield from findings_of(layer, depth, maps, others, {PIXELS: pixels}, asked)


def views_of(
    shown: Shown, layers: AllLayers, before: AllLayers | None, grid: int
) -> dict[str, Maps]:
    """All views of the clips; see :func:`layer_findings`."""
    found: dict[str, Maps] = {}
    for name, view in VIEWS.items():
        # other frames change nothing where each is seen alone
        same = name != PLAIN and layers.alone
        found[name] = found[PLAIN] if same else seen(shown, layers, view, grid)
    if before is not None:
        found[RANDOM] = seen(shown, before, VIEWS[PLAIN], grid)
    return found


def seen(shown: Shown, layers: AllLayers, view: View, grid: int) -> Maps:
    """The maps of all examples under one view, ``(e, c, h, w)`` by layer."""
    parts = [view(layers, b.frames, b.times, b.read, grid) for b in shown.blocks()]
    return {layer: torch.cat([part[layer] for part in parts]) for layer in parts[0]}


def pixels_of(shown: Shown) -> Tensor:
    """What stands for an encoder that does nothing, ``(e, c, h, w)``."""
    return torch.cat([patches(block.frames, block.read) for block in shown.blocks()])


def _files(
    path: Path | str,
    targets: Sequence[str] | Mapping[str, Any],
    each: int,
    columns: Mapping[str, str] | None,
    split_by: str | Sequence[Hashable],
    resample: float | None,
) -> Shown:
    if isinstance(targets, Mapping):
        raise ValueError("probe: `targets` of a folder are names; its tables hold the values")
    if not isinstance(split_by, str):
        raise ValueError("probe: `split_by` of a folder is the name of a fact of its clips")
    pairs = tuple((columns or {}).items())
    return Files(Path(path), ClipSelection(), each, pairs, resample, split_by)


def _arrays(
    clips: Tensor | np.ndarray,
    targets: Sequence[str] | Mapping[str, Any],
    each: int,
    columns: Mapping[str, str] | None,
    split_by: str | Sequence[Hashable],
    resample: float | None,
) -> Shown:
    if not isinstance(targets, Mapping):
        raise ValueError("probe: `targets` of frames are values by name, such as {'speed': speed}")
    if columns is not None or resample is not None:
        raise ValueError("probe: `columns` and `resample` are of files; leave them away")
    return Arrays(torch.as_tensor(clips), targets, each, split_by)


def readout_of(
    name: str, known: Known, each: int, attention: Attention
) -> tuple[Readout, list[Labels]]:
    """The readout of a name, and the targets that it can be asked for.

    Args:
        name: of the readout.
        known: of the clips.
        each: frames of each clip that are read.
        attention: the one that is trained.

    Raises:
        UnknownName: there is none.
        ValueError: one that is told the bodies' places, of clips that do not tell them, or one of
            tracks, of too few frames.
    """
    if name not in READOUTS:
        raise unknown("readout", name, READOUTS)
    labels, bodies = list(known.labels), known.bodies
    if name == ATTENTION:
        return attention, labels
    if name not in (LOCAL, TWO_STAGE):
        return Linear() if name == LINEAR else Linear((name,)), labels
    if isinstance(bodies, str):
        raise ValueError(f"probe: `readout` {name}: {bodies}")
    if name == LOCAL:
        # a place that is given is no question
        return Local(bodies.places), [label for label in labels if label.name != "position"]
    if each < LEAST:
        raise ValueError(f"probe: `each` {each}: `readout` two-stage reads {LEAST} at least")
    return TwoStage(bodies.track), labels
