"""The arrays that a cell's recording is drawn from: one held-out episode, told whole."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, PhaseState, Rollout
from registry.seal import SEAL, arrays_seal
from vidphys.data.clips import Clips
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import DRIFT_STEPS
from vidphys.runs.atomic import write_tensors

SHOWN_STEPS = 500  # reference steps after t0
FLIPPED = -1.0
SCHEMA_VERSION = "2"  # 1 had neither a seal nor its number


def write_showcase(
    path: Path,
    head: Head,
    question: Question,
    rolled: Rollout,
    meta: dict[str, str],
    clips: Clips | None = None,
    tracks: Tracks | None = None,
    attention: Tensor | None = None,
) -> None:
    """The first episode under both laws, in truth and by the head; every array is kept.

    Args:
        path: ``.safetensors`` file; ``meta`` goes into its header.
        head: a trained head.
        question: start and truth of the held-out episodes.
        rolled: what the head was scored by under the law that held, ``DRIFT_STEPS`` or more.
        meta: strings (cell, seed, ...).
        clips, tracks: the frames seen until t0 and what was perceived in them.
        attention: ``(t, n, h, w)``, what was attended to in the first episode's.
    """
    one = question.alone(0, SHOWN_STEPS)
    scene, params = one.scene, one.params
    flipped = params.with_coupling(FLIPPED)
    truth, other = one.reference(params), one.reference(flipped)
    # With all others: one episode by itself does not roll in fused loops.
    changed = question.ask(head, SHOWN_STEPS, question.params.with_coupling(FLIPPED))
    counterfactual = _first(changed, SHOWN_STEPS // question.every)
    predicted = _first(rolled, SHOWN_STEPS // question.every)
    long = _first(rolled, DRIFT_STEPS[-1] // question.every)
    arrays = {
        "times": truth.times,
        "truth": _path(truth.states),
        "prediction": _path(predicted),
        "counterfactual_truth": _path(other.states),
        "counterfactual": _path(counterfactual),
        "energy_truth": scene.energy(truth.states, params)[0],
        "energy_prediction": scene.energy(predicted, params)[0],
        "energy_counterfactual_truth": scene.energy(other.states, flipped)[0],
        "energy_counterfactual": scene.energy(counterfactual, flipped)[0],
        "long_times": rolled.times[: long.q.shape[1]],
        "energy_long": scene.energy(long, params)[0],
    }
    if clips is not None and tracks is not None:
        arrays |= _seen(clips, tracks)
    if attention is not None:
        arrays["attention"] = attention
    extent = 4.0 if clips is None else clips.world.camera.half_extent
    arrays["half_extent"] = torch.tensor(extent, dtype=torch.float64)
    arrays["dt"] = torch.tensor(scene.dt, dtype=torch.float64)
    keep_showcase(path, arrays, {**meta, "coupling": json.dumps(float(params.coupling[0]))})


def keep_showcase(path: Path, arrays: Mapping[str, Tensor], meta: Mapping[str, str]) -> None:
    """Write the arrays and what is said of them, with a hash of both."""
    whole = {name: array.contiguous() for name, array in arrays.items()}
    header = {**meta, "schema_version": SCHEMA_VERSION}
    header[SEAL] = arrays_seal({name: array.numpy() for name, array in whole.items()}, header)
    write_tensors(path, whole, header)


def _first(rolled: Rollout, steps: int) -> PhaseState:
    """The start of the first episode and so many stored states after it, ``(1, t, n, d)``."""
    return rolled.states.map(lambda x: x[:1, : steps + 1])


def _path(states: PhaseState) -> Tensor:
    return states.q[0].double()


def _seen(clips: Clips, tracks: Tracks) -> dict[str, Tensor]:
    """The context: frames as pictures, and perceived positions, at times up to t0 = 0."""
    frames = clips.frames[0]
    channels = frames.shape[1]
    picture = frames.new_zeros(len(frames), 3, *frames.shape[2:])
    for c in range(3):
        picture[:, c] = frames[:, min(c, channels - 1)]
    times = clips.times - clips.times[-1]
    return {
        "frames": picture.permute(0, 2, 3, 1),
        "frame_times": times,
        "track": tracks.positions[0].double(),
    }
