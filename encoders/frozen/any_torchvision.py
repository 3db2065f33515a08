"""Video networks of torchvision, by their name: ``torchvision:NAME``.

The network, its side in pixels and its normalisation are the library's; its classifier is left
out. The whole image is resized to the square, so that nothing of the scene is cut off, unless
another ``fit`` is asked for. Layers are
the modules of its trunk in their order, counted from 1, each with its own stride in time; after the
last comes the network's norm, where it has one. A feature frame stands in the middle of its
receptive field, no later than the last frame.
"""

from __future__ import annotations

import copy
import pickle
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from encoders.frozen.adapter import Adapter
from encoders.frozen.base import Dtype, FrozenEncoder
from encoders.frozen.tokens import chosen_layer, numbered, windowing_words
from encoders.frozen.untrained import fresh
from encoders.frozen.windows import Windowing
from encoders.preprocess import Fit, Fitting, Look, require_square
from encoders.release import WeightsFile, load_tensors, release_sha256
from encoders.weights import find_weights

CODE_VERSION = 1
HEADS = ("head.", "classifier.", "fc.")
STAGES = ("stem", "layer1", "layer2", "layer3", "layer4")  # of the residual networks


@dataclass(frozen=True)
class TorchvisionSettings:
    """What is read, and at which cost.

    Args:
        layer: of the trunk's modules, from 1; the last where not given. Later ones are not run.
        resolution: network pixels of a side; the one that it was trained at where not given.
        fit: how images of another shape are shown, see :class:`encoders.preprocess.Fitting`.
        frames: in a window.
        hop: frames from a window's start to the next one's.
        frame_stride: take each so-many-th frame, before windows are made.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: windows per forward pass.
    """

    layer: int | str | None = None
    resolution: int | None = None
    fit: Fit = "squash"
    frames: int = 16
    hop: int | None = None
    frame_stride: int = 1
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 1


class TorchvisionEncoder(FrozenEncoder):
    """Windows of frames to the maps of a network's trunk.

    Args:
        network: of ``torchvision.models.video``.
        settings: see :class:`TorchvisionSettings`.
        name: that it was asked for by.
        weights: what the network was loaded from.
        look: how it was shown its images.
        fitting: how frames become the network's input.

    Raises:
        ValueError: a layer or a window that the network does not have.
    """

    fitting: Fitting

    def __init__(
        self,
        network: nn.Module,
        settings: TorchvisionSettings,
        name: str,
        weights: WeightsFile,
        look: Look,
        fitting: Fitting,
    ) -> None:
        self.look, self.frames = look, settings.frames
        shapes = _shapes(network, settings.frames, fitting.side)
        if fitting.fit == "pad":
            fitting = fitting.padded(shapes)
        self.fitting = fitting
        layers = numbered(len(shapes))
        self.tubelets = {
            layer: settings.frames // shape[2] for layer, shape in zip(layers, shapes, strict=True)
        }
        self.centres = dict(zip(layers, _centres(network), strict=True))
        layer = chosen_layer(name, settings.layer, layers)
        self.settings = settings
        windowing = self._windowing(layer)
        words = windowing_words(windowing, settings.frame_stride)
        super().__init__(
            network,
            settings,
            windowing,
            layers,
            name=name,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"{words}, rgb, {fitting}, {look}",
            layer=layer,
            resolution=fitting.side,
        )

    @property
    def sight(self) -> Hashable:
        """Layers of one stride in time see the same windows of a clip."""
        return self.windowing.tubelet

    def at(self, layer: int | str) -> FrozenEncoder:
        other, stride = super().at(layer), self.settings.frame_stride
        other.windowing = self._windowing(other.identity.layer)
        own, others = (windowing_words(each.windowing, stride) for each in (self, other))
        told = self.identity.preprocessing.replace(own, others)
        other.identity = replace(other.identity, preprocessing=told)
        return other

    def _windowing(self, layer: str) -> Windowing:
        how = self.frames, self.settings.hop, self.tubelets[layer], self.centres[layer]
        return Windowing(*how)

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> list[Float[Tensor, "n t k h w"]]:
        pixels = self.fitting.pixels(clips, self.look, self.dtype).transpose(1, 2)
        size, found = (clips.shape[-2], clips.shape[-1]), []
        for layer, maps in zip(self.layers, _trunk(self.network, pixels), strict=False):
            if layer in layers:
                found.append(self.fitting.kept(maps, size).transpose(1, 2))
            if layer == layers[-1]:
                break
        return found


def any_torchvision(name: str) -> Adapter:
    """The factory of the encoders over a video network of torchvision."""
    return Adapter(TorchvisionSettings, partial(load_any_torchvision, name, None))


def load_any_torchvision(
    name: str,
    named: str | None,
    settings: TorchvisionSettings,
    where: Path | None,
    device: str,
) -> TorchvisionEncoder:
    """An encoder over a video network of torchvision (see ``load_encoder``).

    Args:
        name: of the network in torchvision.
        named: key of the known weights, of an encoder that has a name here.
        settings, where, device: what is read, where it lies and where it runs.

    Raises:
        ValueError: torchvision has no such video network; those that it has are named.
    """
    from torchvision.models import get_model_weights

    called = named or f"torchvision:{name}"
    build, usual = _builder(name), next(iter(get_model_weights(name)))
    shown = usual.transforms()
    side = settings.resolution or shown.crop_size[0]
    require_square(called, settings.fit)
    before = [pixels * side / shown.crop_size[0] for pixels in shown.resize_size]
    fitting = Fitting(settings.fit, side, before=before[0] if len(before) == 1 else tuple(before))
    look = Look(tuple(shown.mean), tuple(shown.std))
    if name.startswith("mvit") and (side, settings.frames) != (shown.crop_size[0], 16):
        raise ValueError(
            f"{called}: its positions are tables, of 16 frames of {shown.crop_size[0]} pixels; "
            "leave `resolution` and `frames` out"
        )
    make = partial(build, weights=None)
    if settings.seed is not None:
        network, weights = fresh(make, settings.seed)
    else:
        if named is None and where is not None and where.is_file():
            weights = WeightsFile(where, release_sha256(where))
        else:
            weights = find_weights(called, where)
        network = make()
        load_tensors(network, weights.path, _read(weights.path), HEADS)
    return TorchvisionEncoder(network.to(device), settings, called, weights, look, fitting)


def _builder(name: str) -> Any:
    from torchvision.models import get_model_builder, list_models, video

    from registry import unknown

    known = list_models(module=video)
    if name not in known:
        raise unknown("video network of torchvision", name, known)
    return get_model_builder(name)


def _read(path: Path) -> dict[str, Tensor]:
    try:
        found = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
        return {str(key): value for key, value in found.items() if isinstance(value, Tensor)}
    except (RuntimeError, AttributeError, pickle.UnpicklingError, EOFError) as error:
        raise ValueError(
            f"weights: {path} is not a release of torchvision; fetch it again"
        ) from error


def _trunk(network: Any, pixels: Tensor) -> Iterator[Tensor]:
    """Maps ``(n, k, t, h, w)`` of one module of the trunk after the other."""
    if hasattr(network, "conv_proj"):  # MViT
        x = network.conv_proj(pixels)
        size = tuple(x.shape[2:])
        x = network.pos_encoding(x.flatten(2).transpose(1, 2))
        for number, block in enumerate(network.blocks, 1):
            x, size = block(x, size)
            normed = network.norm(x) if number == len(network.blocks) else x
            yield normed[:, 1:].unflatten(1, tuple(size)).permute(0, 4, 1, 2, 3)
        return
    channels_last = hasattr(network, "patch_embed")  # Swin
    x = network.patch_embed(pixels) if channels_last else pixels
    modules = _modules(network)
    for number, module in enumerate(modules, 1):
        x = module(x)
        normed = network.norm(x) if channels_last and number == len(modules) else x
        yield normed.permute(0, 4, 1, 2, 3) if channels_last else normed


def _modules(network: Any) -> list[nn.Module]:
    if hasattr(network, "conv_proj"):
        return list(network.blocks)
    if hasattr(network, "features"):
        return list(network.features)
    return [getattr(network, stage) for stage in STAGES]


def _shapes(network: nn.Module, frames: int, side: int) -> list[tuple[int, ...]]:
    """Shapes of the trunk's maps of one window, found without computing them."""
    blank = torch.zeros(1, 3, frames, side, side, device="meta")
    with torch.inference_mode():
        shadow = copy.deepcopy(network).to("meta").eval()
        return [tuple(maps.shape) for maps in _trunk(shadow, blank)]


def _centres(network: Any) -> list[float]:
    """The frame that the first feature frame of each module is centred on."""
    first: Any = getattr(network, "patch_embed", getattr(network, "conv_proj", nn.Identity()))
    stride, centre = 1, 0.0
    found = []
    for module in (first, *_modules(network)):
        for name, part in module.named_modules():
            if isinstance(part, (nn.Conv3d, nn.MaxPool3d)) and "downsample" not in name:
                kernel, step, pad = (
                    size if isinstance(size, int) else int(size[0])
                    for size in (part.kernel_size, part.stride, part.padding)
                )
                if step > 1:  # others are as wide on both sides
                    centre += stride * ((kernel - 1) / 2 - pad)
                    stride *= step
        found.append(centre)
    return found[1:]
