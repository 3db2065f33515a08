"""All that a training made, as one thing: frames in, and tracks, state and rollout out.

It is rebuilt from the run folder alone, but for the weights of the frozen encoder, which are
looked for where they lie on this machine and refused if they are not the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from binders.tracks import Tracks
from dynamics import Parameters, PhaseState, build, from_config, to_config
from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from readouts.kinds import MapShape, Recipe
from vidphys.data.charts import chart_from_config
from vidphys.data.extraction import Axes
from vidphys.data.frames import Frames
from vidphys.errors import InputError
from vidphys.reading.attention import attention_of, drawn_frames
from vidphys.reading.clip_dynamics import FACTORED, Dynamics, Followed
from vidphys.reading.familiar import Familiar, Flag, Limit
from vidphys.reading.forecasts import Forecast, forecast, state_at
from vidphys.reading.laws import Law
from vidphys.reading.memory import FeatureMemory
from vidphys.reading.reader import LoadedEncoder, Reader, steady
from vidphys.reading.steering import Aim
from vidphys.runs import checkpoint
from vidphys.shooting.step import model_step

FILE = "pipeline.json"


@dataclass(frozen=True)
class Reading:
    """What a pipeline makes of a clip.

    Args:
        tracks: positions as they are seen, world units, one episode.
        camera: displacement of the background in each frame ``(t, 2)``, world units.
        law: that held, batch of one.
        state: at the last frame, in coordinates of the chart, batch of one.
        rollout: from there on, under the same law.
        flags: how it compares with the clips of the training.
        attention: what the readout attends to in the frames that are drawn, ``(f, n, h, w)``; see
            :func:`vidphys.reading.attention.attention_of`.
    """

    tracks: Tracks
    camera: Tensor
    law: Parameters
    state: PhaseState
    rollout: Forecast
    flags: tuple[Flag, ...] = ()
    attention: Tensor | None = None


@dataclass(frozen=True)
class Pipeline:
    """What sees, and the dynamics of what it sees.

    Args:
        reader: frames to tracks.
        recipe: of its readout.
        dynamics: of the tracks.
        familiar: what its training saw; ``None`` for one of before that was kept.
    """

    reader: Reader
    recipe: Recipe
    dynamics: Dynamics
    familiar: Familiar | None = None

    def __call__(
        self,
        frames: Frames,
        times: np.ndarray,
        law: Parameters | None = None,
        beyond: float = 3.0,
        head: str = FACTORED,
    ) -> Reading:
        """Read a clip and roll on from its last frame.

        Args:
            frames: RGB bytes ``(t, H, W, 3)``, row 0 on top.
            times: seconds of each.
            law: that held; coupling and masses one where not given.
            beyond: seconds to roll.
            head: name of the model that rolls.

        Raises:
            InputError: an unknown head, or a clip too short to show momentum.
        """
        self._check_head(head)
        law = law or Parameters(torch.ones(1), torch.ones(1, self.reader.bodies))
        tracks, strange, attention = self._read(frames, times)
        camera = self.reader.camera(frames)
        clip = Followed(steady(tracks, camera), law)
        state = state_at(self.dynamics.heads[head], clip, len(times), self.dynamics)
        rolled = self.roll(state, float(times[-1]), law, beyond, head)
        known = self.familiar
        flags = () if known is None else known.flags(strange, clip, self.dynamics)
        return Reading(tracks, camera, law, state, rolled, tuple(flags), attention)

    def _read(self, frames: Frames, times: np.ndarray) -> tuple[Tracks, Tensor, Tensor | None]:
        """The tracks of a clip, how strange its feature frames are, and what is attended to."""
        look, strange, attention = self.reader.look(frames, times), torch.zeros(0), None

        def see(axes: Axes) -> FeatureMap:
            nonlocal strange, attention
            features = look(axes)
            if not axes:
                drawn = drawn_frames(len(frames))
                attention = attention_of(self.reader.readout, features, drawn)
            if self.familiar is not None and not axes:
                strange = self.familiar.memory.distance(features.values[0])
            return features

        return self.reader.closely(see, torch.tensor(times)), strange, attention

    def roll(
        self,
        state: PhaseState,
        began: float,
        law: Parameters,
        beyond: float,
        head: str = FACTORED,
        factors: Mapping[str, float] | None = None,
        aim: Aim | None = None,
    ) -> Forecast:
        """Roll on from a state, also under a law that never held.

        Args:
            state: of a :class:`Reading`.
            began: its time, seconds.
            law: that is to hold from there on.
            beyond: seconds.
            head: name of the model.
            factors: on the numbers of the model, see :meth:`vidphys.reading.laws.Law.changed`.
            aim: look for a push that takes a body somewhere by then, and roll with it.

        Raises:
            InputError: an unknown head, one that has no such number, or a wrong aim.
        """
        self._check_head(head)
        other = Law(self.dynamics.heads[head], law).changed(factors or {})
        ratio = (other.params.mass / law.mass).unsqueeze(-1).to(state.p)
        state = PhaseState(state.q, state.p * ratio)  # a heavier body is as fast as it was
        return forecast(other.head, state, other.params, self.dynamics, began, beyond, aim)

    def _check_head(self, head: str) -> None:
        if head not in self.dynamics.heads:
            known = ", ".join(self.dynamics.heads)
            raise InputError(f"`head` {head}: this run has {known}")


def save_pipeline(folder: Path, pipeline: Pipeline) -> None:
    """Write a pipeline into a folder of checkpoints, whole or not at all."""
    reader, dynamics = pipeline.reader, pipeline.dynamics
    encoder, readout = reader.encoder, reader.readout
    assert isinstance(readout, nn.Module)
    parts: dict[str, nn.Module] = {"readout": readout}
    parts |= {f"heads/{name}": head for name, head in dynamics.heads.items()}
    known = pipeline.familiar
    tensors = {
        f"{part}/{key}": value.clone()  # parts of a readout may share theirs, files may not
        for part, module in parts.items()
        for key, value in module.state_dict().items()
    }
    meta = {
        "step": 0,
        "encoder": {
            "name": encoder.name,
            "options": encoder.options,
            "identity": asdict(encoder.network.identity),
        },
        "readout": asdict(pipeline.recipe),
        "bodies": reader.bodies,
        "half_extent": reader.half_extent,
        "follows_camera": reader.follows_camera,
        "stride": reader.stride,
        "side": reader.side,
        "mirrors": reader.mirrors,
        "chart": dynamics.chart.to_config(),
        "interval": dynamics.interval,
        "heads": {name: to_config(term) for name, term in dynamics.terms.items()},
        "familiar": None if known is None else known.to_config(),
    }
    if known is not None:
        tensors |= {f"memory/{key}": value for key, value in vars(known.memory).items()}
    checkpoint.save(folder / FILE, tensors, meta)


def load_pipeline(run: Path, weights: Path | None = None, device: str = "cpu") -> Pipeline:
    """Rebuild the pipeline of a finished training.

    Args:
        run: the run folder.
        weights: file or folder of the encoder's weights; else VIDPHYS_WEIGHTS, else the user's
            cache.
        device: where the encoder runs.

    Raises:
        InputError: no pipeline in the folder, a damaged one or one of another version, or another
            encoder than it was trained over.
        ValueError: the encoder's weights are missing or wrong.
    """
    path = run / "checkpoints" / FILE
    if not path.is_file():
        begun = (run / "run.json").is_file()
        what = "its command again, it goes on" if begun else "the folder of `vidphys train`"
        raise InputError(f"{run}: no trained pipeline in it; give {what}")
    tensors, meta = checkpoint.load(path)
    about = meta["encoder"]
    encoder = load_encoder(about["name"], about["options"], weights, device)
    for key, value in asdict(encoder.identity).items():
        if value != about["identity"][key]:
            raise InputError(
                f"{run}: trained over {about['name']} with {key} {about['identity'][key]}, but "
                f"this one has {value}; give the same `weights`, or train again"
            )
    try:
        recipe = _recipe(meta["readout"])
        readout = recipe.build()
        readout.load_state_dict(checkpoint.under("readout", tensors))
        dynamics = _dynamics(tensors, meta)
    except (RuntimeError, TypeError) as error:
        raise InputError(
            f"{run}: its models are of another version of vidphys; train again in another folder"
        ) from error
    reader = Reader(
        LoadedEncoder(about["name"], about["options"], encoder),
        readout.eval(),
        meta["bodies"],
        meta["half_extent"],
        meta["follows_camera"],
        meta["stride"],
        meta["side"],
        meta.get("mirrors", False),
    )
    return Pipeline(reader, recipe, dynamics, _familiar(tensors, meta))


def _familiar(tensors: dict[str, Tensor], meta: dict[str, Any]) -> Familiar | None:
    if meta.get("familiar") is None:
        return None
    limits = {name: Limit(*numbers) for name, numbers in meta["familiar"].items()}
    return Familiar(FeatureMemory(**checkpoint.under("memory", tensors)), limits)


def _recipe(meta: dict[str, Any]) -> Recipe:
    if "kind" not in meta:  # of before there were several kinds
        shape = MapShape(meta["channels"], (0, 0), meta["bodies"])
        return Recipe("attention", shape, {"width": meta["width"]})
    shape = MapShape(**{**meta["shape"], "grid": tuple(meta["shape"]["grid"])})
    return Recipe(meta["kind"], shape, meta["sizes"])


def _dynamics(tensors: dict[str, Tensor], meta: dict[str, Any]) -> Dynamics:
    chart = chart_from_config(meta["chart"])
    terms = {name: from_config(config) for name, config in meta["heads"].items()}
    dt, _ = model_step(meta["interval"])
    heads = {}
    for name, each in terms.items():
        heads[name] = build(each, meta["bodies"], dt, chart.space).eval()
        heads[name].load_state_dict(checkpoint.under(f"heads/{name}", tensors))
    return Dynamics(chart, meta["interval"], terms, heads)
