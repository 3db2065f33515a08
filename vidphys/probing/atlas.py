"""The atlas: encoders, layers, targets and controls, a unit of work for each encoder and seed.

Features come from a store, so that an encoder that was interrupted goes on with what is left. Each
layer and target leaves its numbers as records, and the errors of each clip as episodes, from which
layers are compared with one another.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from encoders.frozen import ENCODERS, load_encoder
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.untrained import untrained
from encoders.identity import LayeredEncoder
from encoders.store import FeatureStore
from vidphys.devices import device_name, prepare_device
from vidphys.points.point import CPU_CLOCK, WALL_CLOCK
from vidphys.probing.controls import RANDOM
from vidphys.probing.examples import PLAIN, VIEWS
from vidphys.probing.files import Files
from vidphys.probing.findings import Asked, Finding
from vidphys.probing.known import Known
from vidphys.probing.layers import Frozen, Maps
from vidphys.probing.probe import layer_findings, pixels_of, readout_of
from vidphys.probing.scores import Score
from vidphys.probing.shown import Shown
from vidphys.probing.stored import StoredExamples
from vidphys.probing.trained import Attention
from vidphys.progress import Progress
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import Origin, Recorder
from vidphys.trade.timing import Timed, in_turn, quartiles

NAME = "atlas"
TIMED_CLIPS, TIMED_ROUNDS = 2, 3
SCORE, SELECTIVITY, COST = "score", "selectivity", "ms_per_clip"
ERROR, CHANCE = "error", "chance"  # of each clip
CALIBRATION, MISCALIBRATION = "calibration", "miscalibration"
KEPT_AS = "kept/"  # and the way: what the score gains by it
FORM = "form/"  # and its name: the share of folds in which the readout took it
MAKERS = ("vidphys.probing.atlas",)


@dataclass(frozen=True)
class AtlasSettings:
    """What is asked of every encoder.

    Args:
        clips: where they lie.
        known: what is known of them.
        targets: by name; all that can be had if none is named.
        layers: of each encoder; all if none is named.
        readout: of :data:`vidphys.probing.readouts.READOUTS`.
        widths, rates: that the readout by attention tries.
        grid: cells on a side that maps are pooled to at most.
        folds: in which all clips are tested.
        kept: cheaper ways to keep features, whose cost is measured.
        store: folder of the features.
        weights: where those of encoders lie.
        device: where they run.
        hashes: of the files of the clips.
    """

    clips: Files
    known: Known
    targets: tuple[str, ...]
    layers: tuple[int | str, ...]
    readout: str
    widths: tuple[int, ...]
    rates: tuple[float, ...]
    grid: int
    folds: int
    kept: tuple[str, ...]
    store: Path
    weights: Path | None
    device: str
    hashes: tuple[str, ...]

    @property
    def shown(self) -> Files:
        """The clips, which the units that a process does one after the other decode once."""
        return _shown(self.clips, self.hashes)


@lru_cache(1)
def _shown(clips: Files, hashes: tuple[str, ...]) -> Files:
    # hashes: so that clips which have changed are decoded anew
    return replace(clips)


@dataclass(frozen=True)
class AtlasUnit:
    """One encoder by name, under one seed."""

    encoder: str
    seed: int

    @property
    def part(self) -> str:
        """The name that its work is kept under."""
        return f"{self.encoder}-s{self.seed}"


def run_unit(path: Path, unit: AtlasUnit, settings: AtlasSettings, report: Any) -> None:
    """Do one unit, unless it is done, and keep its tables.

    Args:
        path: the run folder.
        unit: see there.
        settings: see there.
        report: called as ``(stage, step, steps)``.

    Raises:
        ValueError: an encoder that cannot be had, or nothing that can be learned.
    """
    prepare_device(settings.device)  # again: a worker is a process of its own
    run = RunFolder(path)
    if run.is_done(unit.part):
        return
    began, shown, known = time.perf_counter(), settings.shown, settings.known
    encoder = load_encoder(unit.encoder, {}, settings.weights, settings.device)
    layers = {encoder.at(layer).identity.layer for layer in settings.layers or encoder.layers}
    seen = Frozen(encoder, tuple(layer for layer in encoder.layers if layer in layers))
    attention = Attention(settings.widths, settings.rates)
    readout, labels = readout_of(settings.readout, known, shown.each, attention)
    clips = np.arange(shown.count).repeat(shown.each)
    asked = Asked(labels, clips, known.groups, unit.seed, settings.folds, readout, settings.kept)
    report(f"{unit.part}: pixels", 0, 1)
    pixels = asked.sums(asked.read(pixels_of(shown)))
    views = _views(shown, seen, unit, settings, report)
    recorder = Recorder(_origin(unit, settings, encoder, ""))
    total = len(seen.layers) * len(labels)
    for number, finding in enumerate(layer_findings(views, pixels, asked, encoder.layers)):
        _record(recorder, unit, finding)
        report(f"{unit.part}: layer {finding.layer}", number + 1, total)
    _time(recorder, unit, seen, shown, settings.device)
    recorder.took(time.perf_counter() - began)
    run.finish(unit.part, *recorder.tables(), MAKERS)


def _views(
    shown: Files, seen: Frozen, unit: AtlasUnit, settings: AtlasSettings, report: Any
) -> dict[str, Maps]:
    """All views of the clips, from the store where they lie there."""
    store = FeatureStore(settings.store)
    stored = StoredExamples(store, shown, shown.fingerprints, settings.grid)

    def told(name: str) -> Progress:
        return lambda step, steps, _: report(f"{unit.part}: {name or 'clips'}", step, steps)

    found: dict[str, Maps] = {}
    for name, view in VIEWS.items():
        same = name != PLAIN and seen.alone
        found[name] = found[PLAIN] if same else stored.maps(seen, name, view, told(name))
    if isinstance(seen.encoder, FrozenEncoder):
        before = replace(seen, encoder=untrained(deepcopy(seen.encoder), unit.seed))
        found[RANDOM] = stored.maps(before, PLAIN, VIEWS[PLAIN], told(RANDOM))
    return found


def _origin(unit: AtlasUnit, settings: AtlasSettings, encoder: LayeredEncoder, cell: str) -> Origin:
    return Origin(
        experiment=NAME,
        cell=cell,
        system=settings.clips.path.name,
        grounding="features",
        encoder=unit.encoder,
        binder="none",
        readout=settings.readout,
        head="none",
        seed=unit.seed,
        device=device_name(settings.device),
        dtype=encoder.identity.dtype,
        supervision="labels",
    )


def _record(recorder: Recorder, unit: AtlasUnit, finding: Finding) -> None:
    """All numbers of one layer and target."""
    one = _beside(recorder, f"{unit.encoder}/{finding.layer}/{finding.target.name}")
    one.add_value("depth", finding.depth)
    _interval(one, SCORE, finding.score)
    _interval(one, SELECTIVITY, finding.selectivity)
    for name, score in finding.controls.items():
        _interval(one, f"control/{name}", score)
    for metric in (CALIBRATION, MISCALIBRATION):
        value = getattr(finding, metric)
        if value is not None:
            one.add_value(metric, value)
    for form, folds in finding.forms.items():
        one.add_value(f"{FORM}{form}", folds / sum(finding.forms.values()))
    for name, (gain, bytes_each) in finding.kept.items():
        _interval(one, f"{KEPT_AS}{name}", gain)
        one.add_value(f"bytes/{name}", bytes_each)
    one.add_episodes(ERROR, torch.from_numpy(finding.sums.error))
    one.add_episodes(CHANCE, torch.from_numpy(finding.sums.chance))


def _interval(recorder: Recorder, metric: str, score: Score) -> None:
    recorder.add_value(metric, score.value)
    recorder.add_value(f"{metric}_low", score.low)
    recorder.add_value(f"{metric}_high", score.high)


def _time(recorder: Recorder, unit: AtlasUnit, seen: Frozen, shown: Shown, device: str) -> None:
    """Milliseconds for a clip, all its frames, up to each layer: of the process, or on a card."""
    block = next(iter(shown.blocks()))
    frames = block.frames[:TIMED_CLIPS]
    calls = (partial(seen.encoder.at(layer), frames, block.times) for layer in seen.layers)
    timed = [Timed(call) for call in calls]
    timed[-1].work()  # the first call is none of them
    in_turn(timed, TIMED_ROUNDS, device)
    clock = CPU_CLOCK if device == "cpu" else WALL_CLOCK
    for layer, one in zip(seen.layers, timed, strict=True):
        low, middle, high = (1000 * s / len(frames) for s in quartiles(one.seconds(clock)))
        told = _beside(recorder, f"{unit.encoder}/{layer}")
        _interval(told, COST, Score(middle, low, high))


def _beside(recorder: Recorder, cell: str) -> Recorder:
    return recorder.beside(Origin(**{**asdict(recorder.origin), "cell": cell}))


def settings_of(
    settings: AtlasSettings, encoders: Sequence[str], seeds: Sequence[int]
) -> dict[str, Any]:
    """What makes a run this run, as it stands in ``run.json``; more encoders extend it."""
    for name in encoders:
        ENCODERS[name]  # an unknown one is named before any work
    return {
        "experiment": NAME,
        "cells": list(encoders),
        "seeds": list(seeds),
        "data": settings.clips.path.name,
        "selection": asdict(settings.clips.selection),
        "resample": settings.clips.resample,
        "columns": dict(settings.clips.columns),
        "split_by": settings.clips.split_by,
        "targets": list(settings.targets),
        "layers": list(settings.layers),
        "device": settings.device,
        "readout": settings.readout,
        "widths": list(settings.widths),
        "rates": list(settings.rates),
        "each": settings.clips.each,
        "grid": settings.grid,
        "folds": settings.folds,
        "kept": list(settings.kept),
        "sha256": list(settings.hashes),
        "sources": ENCODERS.sources(*encoders),
    }
