"""Any vision or video model of transformers from a folder in the official layout: ``hf:FOLDER``.

The model is the library's, made by its ``config.json`` and filled from safetensors; no code of a
repository is run, and nothing is fetched. Normalisation and size are those of
``preprocessor_config.json``; the whole picture is resized to the square, so that nothing of the
scene is cut off, unless another ``fit`` is asked for. Which token stands where is not guessed: the
network's first layer is asked with one bright patch, see :mod:`encoders.frozen.token_order`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

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
from encoders.grid import Size
from encoders.known_weights import PROCESSOR, entry
from encoders.preprocess import LOOKS, Fit, Fitting, Look, require_square
from encoders.release import CONFIG, WeightsFile, read_config
from encoders.weights import config_of, find_weights, weights_path

CODE_VERSION = 1
FRAMES = ("num_frames", "frames_per_clip")  # what configurations call a window
ANY_LENGTH = 16  # frames of a window where a model of clips takes any number
TOWERS = ("vision_model", "video_model", "video_encoder")  # of models that see, what sees
RESAMPLE = {2: "bilinear", 3: "bicubic"}  # as the processors number them


@dataclass(frozen=True)
class AnyHubSettings:
    """What is read, and at which cost.

    Args:
        layer: of the model's hidden states, from 1; the last where not given.
        resolution: network pixels of a side; the model's own where not given. One that has a table
            of positions interpolates it, as its library does it, or is refused.
        fit: how images of another shape are shown, see :class:`encoders.preprocess.Fitting`.
        frames: of a video model: in a window; the model's own where not given.
        hop: of a video model: frames from a window's start to the next one's.
        frame_stride: take each so-many-th frame.
        difference: of an image model: frames to either side over which the change of the features
            is read beside them, see :mod:`encoders.frozen.differenced`; not read where not given.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: frames, or windows of a video model, per forward pass.
        runtime: what computes the network; see :mod:`encoders.frozen.runtimes`.
    """

    layer: int | str | None = None
    resolution: int | None = None
    fit: Fit = "squash"
    frames: int | None = None
    hop: int | None = None
    frame_stride: int = 1
    difference: int | None = None
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
        fitting: how frames become its input.

    Raises:
        ValueError: a layer, a resolution or a window that it does not have, or tokens in no order
            that is known.
    """

    fitting: Fitting

    def __init__(
        self,
        model: nn.Module,
        settings: AnyHubSettings,
        name: str,
        weights: WeightsFile,
        look: Look,
        fitting: Fitting,
    ) -> None:
        self.look, self.fitting = look, fitting
        self.input = next(key for key in PIXELS if key in inputs_of(model))
        frames = _told_frames(name, model, self.input, settings.frames)
        self.video = frames > 1
        self.resized = _told_side(model, fitting.side) or settings.frames is not None
        states = partial(states_of, model.eval(), self.input, resized=self.resized)
        shape = (3, fitting.side, fitting.side)
        blank = torch.zeros(1, *((frames,) if self.video else ()), *shape, device=_place(model))
        blurred = cast(Any, model.config).model_type in FRAME_BY_FRAME
        try:
            self.order = ask_order(name, states, blank, 2 if blurred else 0)
        except (RuntimeError, ValueError, AssertionError) as error:
            if settings.resolution is None and settings.frames is None:
                raise
            said = " ".join(str(error).split())[:200]
            raise ValueError(
                f"{name}: its library does not let it take {frames} frame(s) of {fitting.side} "
                f"pixels ({said}); leave `resolution` and `frames` out"
            ) from error
        if fitting.fit == "pad":
            with torch.inference_mode():
                self.fitting = fitting.padded(self.order.maps(x).shape for x in states(blank))
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
            preprocessing=f"{words}, rgb, {self.fitting}, {look}",
            layer=chosen_layer(name, settings.layer, layers),
            resolution=fitting.side,
        )

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> Sequence[Float[Tensor, "n t k h w"]]:
        pixels = self.fitting.pixels(clips, self.look, self.dtype)
        size = clips.shape[-2], clips.shape[-1]
        if self.video:
            return [self.fitting.kept(maps, size) for maps in self.fast_maps(pixels, layers)]
        found = (maps[:, 0] for maps in self.fast_maps(pixels.flatten(0, 1), layers))
        return [self.fitting.kept(maps, size).unflatten(0, clips.shape[:2]) for maps in found]

    def maps(self, pixels: Tensor, layers: tuple[str, ...]) -> list[Tensor]:
        """Pixels as the model takes them to ``(n, t, k, h, w)``; an image has one frame."""
        states = states_of(self.network, self.input, pixels, self.resized)
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
    require_square(name, settings.fit)
    usual = LOOKS[entry(named).look] if named else None
    look, fitting = shown(release, model, settings, usual)
    return AnyHubEncoder(model.to(device), settings, name, weights, look, fitting)


def _told_frames(name: str, model: nn.Module, pixels: str, wanted: int | None) -> int:
    """Frames of a window; a model whose layers count them is told."""
    config: Any = model.config
    usual = ANY_LENGTH if pixels == PIXELS[0] else 1
    key = next((key for key in FRAMES if hasattr(config, key)), None)
    own = usual if key is None else int(getattr(config, key))
    if wanted is None or wanted == own:
        return own
    if own == 1:
        raise ValueError(f"{name}: sees one image at a time; leave `frames` out")
    for part in (config, *model.modules()) if key is not None else ():
        if getattr(part, cast(str, key), None) == own:
            setattr(part, cast(str, key), wanted)
    return wanted


def _told_side(model: nn.Module, side: int) -> bool:
    """Whether a model sees pictures of another size than its own, which it is told."""
    config: Any = model.config
    own = getattr(config, "image_size", None)
    if own is None or side in (own, *(own if isinstance(own, (list, tuple)) else ())):
        return False
    config.image_size = side if isinstance(own, int) else [side, side]
    return True


def _place(model: nn.Module) -> torch.device:
    return next(model.parameters()).device


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


def shown(
    folder: Path, model: nn.Module, settings: AnyHubSettings, usual: Look | None = None
) -> tuple[Look, Fitting]:
    """How a model was shown its images, and how frames become its square.

    Args:
        folder: of the release, with or without its processor's configuration.
        model: that is shown them.
        settings: of the encoder.
        usual: how, where the folder does not say it.
    """
    told: dict[str, Any] = {}
    for name in PROCESSOR:
        if (folder / name).is_file():
            told = json.loads((folder / name).read_text(encoding="utf-8"))
    mean, std = told.get("image_mean"), told.get("image_std")
    if mean is None or not told.get("do_normalize", True):
        mean, std = ((0.0,) * 3, (1.0,) * 3) if told else (Look.mean, Look.std)
    size = told.get("crop_size") or told.get("size") or {}
    side = _own_side(model) or (
        size if isinstance(size, int) else size.get("height", size.get("shortest_edge"))
    )
    side = int((side[0] if isinstance(side, (list, tuple)) else side) or 224)
    before = _before(told, settings.resolution or side)
    fitting = Fitting(settings.fit, settings.resolution or side, before=before)
    if not told and usual is not None:
        return usual, fitting
    mode = RESAMPLE.get(told.get("resample", 2), "bicubic")
    return Look(tuple(mean), tuple(std or Look.std), mode), fitting


def _own_side(model: nn.Module) -> Any:
    """Pixels that a model, or the network of timm inside of it, is made for, if it says so."""
    config: Any = model.config
    own = getattr(config, "image_size", None) or getattr(config, "crop_size", None)
    return own or next((x.img_size for x in model.modules() if hasattr(x, "img_size")), None)


def _before(told: Mapping[str, Any], side: int) -> int | float | Size | None:
    """Pixels that a processor resizes pictures to, of which it then cuts ``side``."""
    size, cut = told.get("size"), told.get("crop_size")
    if not (size and cut and told.get("do_center_crop", True)):
        return None
    scale = side / (cut if isinstance(cut, int) else cut["height"])
    if isinstance(size, int) or "shortest_edge" in size:
        return scale * (size if isinstance(size, int) else size["shortest_edge"])
    return scale * size["height"], scale * size["width"]
