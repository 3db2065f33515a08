"""``vidphys.probe``: what an encoder knows of targets, layer by layer, beside all controls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from registry import unknown
from vidphys.data.video import ClipSelection
from vidphys.probing.controls import CONTROLS, PIXELS, POOLED, RANDOM
from vidphys.probing.examples import GRID, PLAIN, VIEWS, View, patches
from vidphys.probing.findings import Asked, Finding, findings_of
from vidphys.probing.forms import pooled
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
from vidphys.probing.shown import Arrays, Folder, Shown
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
) -> Probed:
    """What the layers of an encoder know of targets, with every control.

    Every clip is predicted by a readout that has not seen it. Intervals are of 95 %, by clip.

    Args:
        encoder: a frozen encoder, or anything that takes frames ``(b, t, 3, H, W)`` in [0, 1] and
            gives features ``(b, t, c, h, w)``, ``(b, t, c)`` or ``(b, c)``, or a mapping of such
            layers in order of depth. ``t`` may be smaller than the clip's.
        clips: frames ``(clips, t, 3, H, W)``, bytes or floats in [0, 1]; or a folder of clips with
            a table beside each, or of ``vidphys render``.
        targets: of a folder, names (see :data:`TARGETS`; ``column:``, ``angle:`` or ``class:`` and
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

    Raises:
        ValueError: arrays of wrong shapes, too few clips, or nothing that can be learned.
        InputError: clips or tables that cannot be read.
    """
    layers, shown = all_layers(encoder), _shown(clips, targets, each)
    if shown.count < 2 * folds:
        raise ValueError(f"probe: {shown.count} clips; {folds} folds need at least {2 * folds}")
    named = () if isinstance(targets, Mapping) else tuple(targets)
    labels, skipped = shown.labels(named)
    if not labels:
        raise ValueError(f"probe: nothing can be learned: {skipped or 'no targets were given'}")
    how, labels = readout_of(readout, shown, labels, Attention(widths, rates))
    asked = Asked(labels, np.arange(shown.count).repeat(each), seed, folds, how)
    before = untrained_of(encoder, untrained, seed)
    views = views_of(shown, layers, before, grid)
    pixels = asked.sums(asked.read(pixels_of(shown)))
    found = layer_findings(views, pixels, asked)
    why = {} if before else {RANDOM: "give `untrained`: the encoder before any training"}
    return Probed(tuple(found), skipped, why)


def layer_findings(
    views: Mapping[str, Maps], pixels: Sequence[Sums], asked: Asked
) -> Iterator[Finding]:
    """Findings of every layer and target.

    Args:
        views: the maps of all layers by control that needs other ones; those of the clips as they
            are under :data:`PLAIN`.
        pixels: errors of what reads the pixels.
        asked: what is read.
    """
    plain = views[PLAIN]
    for number, (layer, maps) in enumerate(plain.items()):
        others = {name: view[layer] for name, view in views.items() if name and layer in view}
        depth = number / max(1, len(plain) - 1)
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


def _shown(clips: Any, targets: Sequence[str] | Mapping[str, Any], each: int) -> Shown:
    if isinstance(clips, str | Path):
        if isinstance(targets, Mapping):
            raise ValueError("probe: `targets` of a folder are names; its tables hold the values")
        return Folder(Path(clips), ClipSelection(), each)
    if not isinstance(targets, Mapping):
        raise ValueError("probe: `targets` of frames are values by name, such as {'speed': speed}")
    return Arrays(torch.as_tensor(clips), targets, each)


def readout_of(
    name: str, shown: Shown, labels: Sequence[Labels], attention: Attention
) -> tuple[Readout, list[Labels]]:
    """The readout of a name, and the targets that it can be asked for.

    Raises:
        UnknownName: there is none.
        ValueError: one that is told the bodies' places, of clips that do not tell them, or one of
            tracks, of too few frames.
    """
    if name not in READOUTS:
        raise unknown("readout", name, READOUTS)
    if name == LOCAL:
        # a place that is given is no question
        return Local(shown.places()), [each for each in labels if each.name != "position"]
    if name == TWO_STAGE:
        if shown.each < LEAST:
            raise ValueError(
                f"probe: `each` {shown.each}: `readout` two-stage reads {LEAST} at least"
            )
        return TwoStage(shown.track()), list(labels)
    if name == ATTENTION:
        return attention, list(labels)
    return Linear() if name == LINEAR else Linear((name,)), list(labels)
