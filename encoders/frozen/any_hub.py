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
from encoders.frozen.hub_states import FRAME_BY_FRAME, PIXELS, inputs_of, states_of
from encoders.frozen.published import configuration, published
from encoders.frozen.runtimes import Runtime
from encoders.frozen.token_order import ask_order
from encoders.frozen.tokens import chosen_layer, numbered, windowing_words
from encoders.frozen.untrained import fresh
from encoders.frozen.windows import Windowing
from encoders.known_weights import entry
from encoders.preprocess import LOOKS, Look
from encoders.release import CONFIG, WeightsFile, read_config
from encoders.weights import config_of, find_weights, weights_path

CODE_VERSION = 1
PREPROCESSOR = ("preprocessor_config.json", "video_preprocessor_config.json")
FRAMES = ("num_frames", "frames_per_clip")  # what configurations call a window
ANY_LENGTH = 16  # frames of a window where a model of clips takes any number
TOWERS = ("vision_model", "video_model", "video_encoder")  # of models that see, what sees
RESAMPLE = {2: "bilinear", 3: "bicubic"}  # as the processors number them


@dataclass(frozen=True)
class AnyHubSettings:
    """What is read, and at which cost.

    Args:
        layer: of the model's hidden states, from 1; the last where not given.
        hop: of a video model: frames from a window's start to the next one's.
        frame_stride: take each so-many-th frame.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
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
        self.input = next(key for key in PIXELS if key in inputs_of(model))
        usual = ANY_LENGTH if self.input == PIXELS[0] else 1
        frames = next((int(getattr(config, key)) for key in FRAMES if hasattr(config, key)), usual)
        self.video, self.place = frames > 1, next(model.parameters()).device
        states = partial(states_of, model.eval(), self.input)
        blurred = config.model_type in FRAME_BY_FRAME
        self.order = ask_order(name, states, self._blank(frames), 2 if blurred else 0)
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
    return Adapter(AnyHubSettings, partial(load_any_hub, place, None))


def load_any_hub(
    place: str, named: str | None, settings: AnyHubSettings, where: Path | None, device: str
) -> AnyHubEncoder:
    """An encoder over a model of transformers (see ``load_encoder``).

    Args:
        place: see :func:`any_hub`.
        named: key of the known weights, of an encoder that has a name here.
        settings, where, device: what is read, where it lies and where it runs.
    """
    name, folder = named or f"hf:{place}", Path(place)
    if where is None and (folder / CONFIG).is_file():
        where, name = folder, f"hf:{folder.resolve().name}"
    if settings.seed is None:
        weights = find_weights(named, where) if named else published(name, place, where)
        release, config = weights.path, read_config(weights.path, {})
        model = _model(name, config, release)
    else:
        if named:
            release = weights_path(named, where)
            config = config_of(named, where, {}, entry(named).config)
        else:
            release = configuration(name, place, where)
            config = read_config(release, {})
        model, weights = fresh(partial(_model, name, config, None), settings.seed)
    usual = LOOKS[entry(named).look] if named else None
    look, side = shown(release, model.config, usual)
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
    for tower in TOWERS:
        made = getattr(made, tower, made)
    return made


def shown(folder: Path, config: Any, usual: Look | None = None) -> tuple[Look, int]:
    """How a model was shown its images, and the side of its square in pixels.

    Args:
        folder: of the release, with or without its processor's configuration.
        config: of the model.
        usual: how, where the folder does not say it.
    """
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
    if not told and usual is not None:
        return usual, int(side or 224)
    mode = RESAMPLE.get(told.get("resample", 2), "bicubic")
    return Look(tuple(mean), tuple(std or Look.std), mode), int(side or 224)
