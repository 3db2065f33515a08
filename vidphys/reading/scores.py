"""What a training is worth, on clips or frames that none of it has seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from binders.tracks import Tracks
from vidphys.metrics import FAILED, OK, Summary
from vidphys.reading.clip_dynamics import friction_of
from vidphys.reading.forecasts import Forecast, forecast, forecast_error, naive_forecasts, state_at
from vidphys.reading.pipeline import Pipeline
from vidphys.reading.reader import steady
from vidphys.reading.training import Perceived, labelled
from vidphys.runs.records import Origin, Recorder
from vidphys.training.candidates import ATTENTION, POOLED, TrainedReadout, best_of
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
    origin = recorder.origin
    for each in perceived.readouts:
        _origin(recorder, origin, each.candidate.name, each.candidate.kind)
        error, lost = each.fit.held_out_error, Summary(None, FAILED, 0, 0)
        found = Summary(error, OK, 0, 0) if math.isfinite(error) else lost
        recorder.add("held_out_error_normalised", found)
        recorder.add_value("kept_step", each.fit.kept_step)
        recorder.add_value("steps", each.fit.steps)
    for kind in (ATTENTION, POOLED):
        best = best_of(kind, perceived.readouts)
        _add_rmse(recorder, origin, kind, _scored_rmse(perceived, best), perceived)
    _add_rmse(recorder, origin, CONSTANT, _scored_rmse(perceived, None), perceived)
    recorder.origin = origin


def _add_rmse(
    recorder: Recorder, origin: Origin, name: str, rmse: float, perceived: Perceived
) -> None:
    _origin(recorder, origin, name, name)
    recorder.add_value("readout_rmse_normalised", rmse)
    recorder.add_value("readout_rmse_pixels", rmse * max(perceived.clips[0].size) / 2)


def _origin(recorder: Recorder, origin: Origin, name: str, readout: str) -> None:
    recorder.origin = replace(origin, cell=f"readout/{name}", readout=readout)


def _scored_rmse(perceived: Perceived, trained: TrainedReadout | None) -> float:
    """Of a readout, or of saying the mean training position, normalised image units."""
    clips, layer = perceived.clips, (trained or perceived.chosen).candidate.layer
    split = perceived.splits[layer]
    scored = labelled(clips, layer, split.scored, split.each)
    if trained is not None:
        positions, _ = read_all(trained.module, scored.values, scored.centres)
    else:
        train = labelled(clips, layer, split.train, split.each)
        positions = train.targets.mean(0).expand_as(scored.targets)
    return position_rmse(positions, scored.targets, scored.weight)


def record_forecasts(
    recorder: Recorder, perceived: Perceived, pipeline: Pipeline, told: Sequence[Told]
) -> None:
    """The error of each forecast against the labels, pooled over the scored clips and for each."""
    origin, extent = recorder.origin, pipeline.reader.half_extent
    for name in told[0].forecasts:
        recorder.origin = replace(origin, cell=f"clip/{name}", head=name)
        errors = torch.tensor([_error(perceived, each, name) / extent for each in told])
        pooled = float(errors.square().mean().sqrt())
        recorder.add_value("forecast_rmse_normalised", pooled)
        recorder.add_episodes("forecast_rmse_normalised", errors)
        head = pipeline.dynamics.heads.get(name)
        friction = None if head is None else friction_of(head)
        if friction is not None:
            recorder.add_value("friction_per_second", friction)
    recorder.origin = origin


def _error(perceived: Perceived, told: Told, name: str) -> float:
    """World units, against the labels as a camera without drift would have seen them."""
    clip, extent = perceived.clips[told.clip], perceived.reader.half_extent
    labels = clip.labels
    still = steady(labels, clip.camera)
    judge = Tracks(extent * still.positions, still.confidence, still.times)
    frames = torch.arange(told.start, len(labels.times))
    return forecast_error(told.forecasts[name], judge, frames)
