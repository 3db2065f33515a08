"""Any vision or video model of transformers from a folder in the official layout: ``hf:FOLDER``.

The model is the library's, made by its ``config.json`` and filled from safetensors; no code of a
repository is run, and nothing is fetched. Normalisation and size are those of
``preprocessor_config.json``. Which token stands where is not guessed: the network's first layer is
asked with one bright patch, see :mod:`encoders.frozen.token_order`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from encoders.frozen.adapter import Adapter
from encoders.frozen.base import Dtype, FrozenEncoder
from encoders.frozen.published import fresh, published
from encoders.frozen.runtimes import Runtime
from encoders.frozen.token_order import ask_order
from encoders.frozen.tokens import chosen_layer, numbered, windowing_words
from encoders.frozen.windows import Windowing
from encoders.preprocess import Look
from encoders.release import CONFIG, WeightsFile, read_config

CODE_VERSION = 1
PREPROCESSOR = ("preprocessor_config.json", "video_preprocessor_config.json")
FRAMES = ("num_frames", "frames_per_clip")  # what configurations call a window
PIXELS = ("pixel_values_videos", "pixel_values")  # what models call their input
RESAMPLE = {2: "bilinear", 3: "bicubic"}  # as the processors number them


@dataclass(frozen=True)
class AnyHubSettings:
    """What is read, and at which cost.

    Args:
        layer: of the model's hidden states, from 1; the last where not given.
        hop: of a video model: frames from a window's start to the next one's.
        frame_stride: take each so-many-th frame.
        seed: take fresh weights drawn from it in place of trained ones, as a control.
        dtype: of the computation.
        batch: frames, or windows of a video model, per forward pass.
        runtime: what computes the network; see :mod:`encoders.frozen.runtimes`.
    """

    layer: int | str | None = None
    hop: int | None = None
    frame_stride: int = 1
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 4
    runtime: Runtime = "torch"


class AnyHubEncoder(FrozenEncoder):
    """Frames, or windows of them, to maps of one hidden layer.

    Args:
        model: of transformers.
        settings: see :class:`AnyHubSettings`.
        name: that it was asked for by.
        weights: what it was loaded from.
        look: how it was shown its images.
        side: network pixels of a side; the whole image is resized to the square.

    Raises:
        ValueError: a layer that it does not have, or tokens in no order that is known.
    """

    def __init__(
        self,
        model: nn.Module,
        settings: AnyHubSettings,
        name: str,
        weights: WeightsFile,
        look: Look,
        side: int,
    ) -> None:
        config: Any = model.config
        self.look, self.side, self.what = look, side, name
        frames = next((int(getattr(config, key)) for key in FRAMES if hasattr(config, key)), 1)
        self.video, self.place = frames > 1, next(model.parameters()).device
        self.input = next(key for key in PIXELS if key in inputs_of(model))
        states = partial(states_of, model.eval(), self.input)
        self.order = ask_order(name, states, self._blank(frames))
        layers = numbered(self.order.layers)
        windowing = Windowing(frames, settings.hop, frames // self.order.grid.frames)
        words = windowing_words(windowing, settings.frame_stride)
        super().__init__(
            model,
            settings,
            windowing,
            layers,
            name=name,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"{words}, rgb, the image to the square, {look}",
            layer=chosen_layer(name, settings.layer, layers),
            resolution=side,
        )

    def _blank(self, frames: int) -> Tensor:
        shape = (1, frames, 3, self.side, self.side) if self.video else (1, 3, self.side, self.side)
        return torch.zeros(shape, device=self.place)

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> Sequence[Float[Tensor, "n t k h w"]]:
        pixels = self.look.clips(clips, (self.side, self.side), self.dtype)
        if self.video:
            return self.fast_maps(pixels, layers)
        found = self.fast_maps(pixels.flatten(0, 1), layers)
        return [maps.unflatten(0, clips.shape[:2])[:, :, 0] for maps in found]

    def maps(self, pixels: Tensor, layers: tuple[str, ...]) -> list[Tensor]:
        """Pixels as the model takes them to ``(n, t, k, h, w)``; an image has one frame."""
        states = states_of(self.network, self.input, pixels)
        return [self.order.maps(states[int(layer)]) for layer in layers]


def any_hub(place: str) -> Adapter:
    """The factory of the encoders over a model of transformers.

    Args:
        place: a folder with ``config.json``, or ``OWNER/NAME`` in the hub's own cache.
    """
    return Adapter(AnyHubSettings, partial(_load, place))


def _load(place: str, settings: AnyHubSettings, where: Path | None, device: str) -> AnyHubEncoder:
    name, folder = f"hf:{place}", Path(place)
    if where is None and (folder / CONFIG).is_file():
        where, name = folder, f"hf:{folder.resolve().name}"
    if settings.seed is not None and where is not None:
        weights, released = fresh(settings.seed), WeightsFile(where, "")
    else:
        weights = released = published(name, place, where)
    config = read_config(released, {})
    with torch.random.fork_rng():
        torch.manual_seed(settings.seed or 0)
        model = _model(name, config, None if settings.seed is not None else released.path)
    look, side = shown(released.path, model.config)
    return AnyHubEncoder(model.to(device), settings, name, weights, look, side)


def _model(name: str, config: Mapping[str, Any], filled_from: Path | None) -> nn.Module:
    """The part of a model that sees, with its weights; of one with a text tower, the other."""
    from transformers import AutoConfig, AutoModel
    from transformers.utils import logging

    logging.disable_progress_bar()
    kind = config.get("model_type")
    try:
        told = AutoConfig.for_model(**config)
        made: Any
        if filled_from is None:
            made = AutoModel.from_config(told)
        else:
            made, report = AutoModel.from_pretrained(
                filled_from,
                config=told,
                local_files_only=True,
                use_safetensors=True,
                trust_remote_code=False,
                output_loading_info=True,
                dtype=torch.float32,
            )
            missing = [key for key in report["missing_keys"] if "pooler" not in key]
            if missing:
                raise ValueError(f"{len(missing)} weights are missing, {missing[0]} first")
    except (KeyError, ValueError, TypeError, OSError) as error:
        said = " ".join(str(error).split())[:300]
        raise ValueError(f"{name}: transformers cannot make a {kind!r} of it ({said})") from error
    return getattr(made, "vision_model", made)


def inputs_of(model: nn.Module) -> list[str]:
    """Names of what a model is called with."""
    from inspect import signature

    found = list(signature(model.forward).parameters)
    if not set(found) & set(PIXELS):
        raise ValueError(
            f"hf: a {type(model).__name__} does not see pictures (it takes {', '.join(found[:4])})"
        )
    return found


def states_of(model: nn.Module, name: str, pixels: Tensor) -> tuple[Tensor, ...]:
    """All hidden states, that of the embedding first.

    Raises:
        ValueError: the model gives none.
    """
    more = {"skip_predictor": True} if "skip_predictor" in inputs_of(model) else {}
    try:
        found = model(**{name: pixels}, output_hidden_states=True, return_dict=True, **more)
    except TypeError as error:
        what, said = type(model).__name__, str(error).partition("forward() ")[2]
        raise ValueError(f"hf: a {what} sees more than pictures ({said})") from error
    states = getattr(found, "reshaped_hidden_states", None) or found.hidden_states
    if not states:
        raise ValueError(f"hf: a {type(model).__name__} gives no hidden states")
    return tuple(states)


def shown(folder: Path, config: Any) -> tuple[Look, int]:
    """How a model was shown its images, and the side of its square in pixels."""
    told: dict[str, Any] = {}
    for name in PREPROCESSOR:
        if (folder / name).is_file():
            told = json.loads((folder / name).read_text(encoding="utf-8"))
    mean, std = told.get("image_mean"), told.get("image_std")
    if mean is None or not told.get("do_normalize", True):
        mean, std = ((0.0,) * 3, (1.0,) * 3) if told else (Look.mean, Look.std)
    size = told.get("crop_size") or told.get("size") or {}
    own = getattr(config, "image_size", None) or getattr(config, "crop_size", None)
    side = own or (size if isinstance(size, int) else size.get("height", size.get("shortest_edge")))
    side = side[0] if isinstance(side, (list, tuple)) else side
    look = Look(
        tuple(mean), tuple(std or Look.std), RESAMPLE.get(told.get("resample", 2), "bicubic")
    )
    return look, int(side or 224)
