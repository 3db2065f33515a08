"""What a training is worth, on clips or frames that none of it has seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from binders.tracks import Tracks
from vidphys.reading.clip_dynamics import friction_of
from vidphys.reading.forecasts import Forecast, forecast, forecast_error, naive_forecasts, state_at
from vidphys.reading.pipeline import Pipeline
from vidphys.reading.reader import steady
from vidphys.reading.seen_clips import pieces
from vidphys.reading.training import Perceived
from vidphys.runs.records import Recorder
from vidphys.summary import FAILED, OK, Summary
from vidphys.training.candidates import TrainedReadout, best_of
from vidphys.training.readouts import position_rmse, read_all

CONSTANT = "constant"


@dataclass(frozen=True)
class Told:
    """What was foretold of one scored clip.

    Args:
        clip: its number.
        start: first frame that was foretold.
        forecasts: by the name of the model.
    """

    clip: int
    start: int
    forecasts: dict[str, Forecast]


def foretell(perceived: Perceived, pipeline: Pipeline, beyond: float) -> list[Told]:
    """Roll every head through the scored part of each scored clip, and past its end.

    Args:
        perceived, pipeline: see there.
        beyond: seconds past the last frame.
    """
    told = []
    dynamics = pipeline.dynamics
    for clip, start in enumerate(perceived.split.asked):
        if start is None:
            continue
        seen = perceived.followed(clip)
        times = seen.track.times
        forecasts = {}
        for name, head in dynamics.heads.items():
            state = state_at(head, seen, start, dynamics)
            began = float(times[start - 1])
            seconds = float(times[-1]) - began + beyond
            forecasts[name] = forecast(head, state, seen.law, dynamics, began, seconds)
        told.append(Told(clip, start, forecasts | naive_forecasts(seen.track, start)))
    return told


def record_readouts(recorder: Recorder, perceived: Perceived) -> None:
    """Every candidate's held-out error, and the scored errors of the best ones and of the mean."""
    for each in perceived.readouts:
        own = _of_readout(recorder, each.candidate.name, each.candidate.kind)
        error, lost = each.fit.held_out_error, Summary(None, FAILED, 0, 0)
        found = Summary(error, OK, 0, 0) if math.isfinite(error) else lost
        own.add("held_out_error_normalised", found)
        own.add_value("kept_step", each.fit.kept_step)
        own.add_value("steps", each.fit.steps)
    kinds = dict.fromkeys(each.candidate.kind for each in perceived.readouts)
    best = {kind: best_of(kind, perceived.readouts) for kind in kinds}
    for name, readout in {**best, CONSTANT: None}.items():
        own, rmse = _of_readout(recorder, name, name), _scored_rmse(perceived, readout)
        own.add_value("readout_rmse_normalised", rmse)
        own.add_value("readout_rmse_pixels", rmse * max(perceived.clips[0].size) / 2)


def _of_readout(recorder: Recorder, name: str, readout: str) -> Recorder:
    return recorder.beside(replace(recorder.origin, cell=f"readout/{name}", readout=readout))


def _scored_rmse(perceived: Perceived, trained: TrainedReadout | None) -> float:
    """Of a readout, or of saying the mean training position, normalised image units."""
    clips, layer = perceived.clips, (trained or perceived.chosen).candidate.layer
    split = perceived.splits[layer]
    if trained is None:
        taught = pieces(clips, layer, split.train, split.each)
        usual = torch.cat([some.targets for some in taught]).mean(0)
    positions, targets, weights = [], [], []
    for some in pieces(clips, layer, split.scored, split.each):
        if trained is None:
            positions.append(usual.expand_as(some.targets))
        else:
            positions.append(read_all(trained.module, some.values, some.centres)[0])
        targets.append(some.targets)
        weights.append(some.weight)
    return position_rmse(*(torch.cat(every) for every in (positions, targets, weights)))


def record_forecasts(
    recorder: Recorder, perceived: Perceived, pipeline: Pipeline, told: Sequence[Told]
) -> None:
    """The error of each forecast against the labels, pooled over the scored clips and for each."""
    extent = pipeline.reader.half_extent
    for name in told[0].forecasts:
        own = recorder.beside(replace(recorder.origin, cell=f"clip/{name}", head=name))
        errors = torch.tensor([_error(perceived, each, name) / extent for each in told])
        pooled = float(errors.square().mean().sqrt())
        own.add_value("forecast_rmse_normalised", pooled)
        own.add_episodes("forecast_rmse_normalised", errors)
        head = pipeline.dynamics.heads.get(name)
        friction = None if head is None else friction_of(head)
        if friction is not None:
            own.add_value("friction_per_second", friction)


def _error(perceived: Perceived, told: Told, name: str) -> float:
    """World units, against the labels as a camera without drift would have seen them."""
    clip, extent = perceived.clips[told.clip], perceived.reader.half_extent
    labels = clip.labels
    still = steady(labels, clip.camera)
    judge = Tracks(extent * still.positions, still.confidence, still.times)
    frames = torch.arange(told.start, len(labels.times))
    return forecast_error(told.forecasts[name], judge, frames)
