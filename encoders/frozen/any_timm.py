"""Any image network of timm that gives feature maps, by its name: ``timm:NAME``.

The network, its layers, its image size and its normalisation are the library's. Class and register
tokens are left out. A network that takes images of any size sees the clip's own shape; one of a
fixed size sees the whole image resized to its square, so that nothing of the scene is cut off,
unless another ``fit`` is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from torch import nn

from encoders.frozen.adapter import Adapter
from encoders.frozen.base import Dtype
from encoders.frozen.published import published
from encoders.frozen.runtimes import Runtime
from encoders.frozen.timm_maps import TimmMaps
from encoders.frozen.tokens import chosen_layer, numbered
from encoders.frozen.untrained import fresh
from encoders.known_weights import timm_repository
from encoders.preprocess import Fit, Fitting, Look, require_square
from encoders.release import CONFIG, WeightsFile, load_strict, read_config
from encoders.weights import find_weights

CODE_VERSION = 1
SHOWN = ("mean", "std", "input_size", "interpolation", "fixed_input_size", "crop_pct", "crop_mode")
MODES = {"bilinear": "bilinear", "bicubic": "bicubic"}  # others are taken as bicubic


@dataclass(frozen=True)
class AnyTimmSettings:
    """What is read, and at which cost.

    Args:
        layer: of the network's feature maps, from 1: blocks of a transformer, stages of others; the
            last where not given.
        resolution: network pixels of the longer image side; the network's own where not given.
        fit: how images of another shape are shown, see :class:`encoders.preprocess.Fitting`: in
            their own shape where the network takes any, else squashed to the square.
        frame_stride: take each so-many-th frame.
        difference: frames to either side over which the change of the features is read beside
            them, see :mod:`encoders.frozen.differenced`; not read where not given.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: frames per forward pass.
        runtime: what computes the network; see :mod:`encoders.frozen.runtimes`.
    """

    layer: int | str | None = None
    resolution: int | None = None
    fit: Fit | None = None
    frame_stride: int = 1
    difference: int | None = None
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 8
    runtime: Runtime = "torch"


class AnyTimmEncoder(TimmMaps):
    """Frames to maps of one layer of a network of timm.

    Args:
        network: the timm model.
        settings: see :class:`AnyTimmSettings`.
        name: that it was asked for by.
        weights: what the network was loaded from.

    Raises:
        ValueError: a layer or a resolution that the network does not have.
    """

    def __init__(
        self, network: Any, settings: AnyTimmSettings, name: str, weights: WeightsFile
    ) -> None:
        from timm.data import resolve_model_data_config

        data = resolve_model_data_config(network)
        known = network.feature_info
        reductions = [info["reduction"] for info in known]
        layers = numbered(len(reductions))
        multiple, square = max(reductions), not _any_size(network)
        own = data["input_size"][-1]
        resolution = settings.resolution or own - own % multiple
        if square and resolution != own:
            raise ValueError(
                f"{name}: sees images of {own} pixels only, not {resolution}; leave "
                "`resolution` out"
            )
        fit: Fit = settings.fit or ("squash" if square else "keep")
        if square:
            require_square(name, fit)
        shorter = math.floor(resolution / data["crop_pct"])
        before = (shorter, shorter) if data["crop_mode"] == "squash" else shorter
        fitting = Fitting(fit, resolution, 1 if square and fit != "pad" else multiple, before)
        look = Look(
            tuple(data["mean"]), tuple(data["std"]), MODES.get(data["interpolation"], "bicubic")
        )
        super().__init__(
            network,
            settings,
            fitting,
            norm=_normed(network),
            look=look,
            layers=layers,
            name=name,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"each {settings.frame_stride}. frame, rgb, {fitting}, {look}",
            layer=chosen_layer(name, settings.layer, layers),
        )


def any_timm(name: str) -> Adapter:
    """The factory of the encoders over a network of timm.

    Raises:
        ValueError: timm has no such network; the nearest spelling is given.
    """
    return Adapter(AnyTimmSettings, partial(load_any_timm, name, None))


def load_any_timm(
    name: str, named: str | None, settings: AnyTimmSettings, where: Path | None, device: str
) -> AnyTimmEncoder:
    """An encoder over a network of timm (see ``load_encoder``).

    Args:
        name: of the network in timm.
        named: key of the known weights, of an encoder that has a name here.
        settings, where, device: what is read, where it lies and where it runs.
    """
    called = named or f"timm:{name}"
    if settings.seed is not None:
        network, weights = fresh(partial(_built, name, {}), settings.seed)
    else:
        if named is None:
            weights = published(called, timm_repository(name), where)
        else:
            weights = find_weights(named, where)
        network = _built(name, _told(name, weights))
        head = network.default_cfg.get("classifier") or "head"
        heads = (head,) if isinstance(head, str) else tuple(head)
        load_strict(network, weights.path, unused=tuple(f"{part}." for part in heads))
    return AnyTimmEncoder(network.to(device), settings, called, weights)


def _built(name: str, arguments: dict[str, Any]) -> Any:
    import timm
    from timm.models import is_model

    from registry import unknown

    if not is_model(name.partition(".")[0]):
        raise unknown("network of timm", name, _near(name))
    make: Callable[..., nn.Module] = partial(
        timm.create_model, name, pretrained=False, num_classes=0, **arguments
    )
    try:
        network = make(dynamic_img_size=True)
    except TypeError:  # it has one size, or takes any without being told
        network = make()
    if not hasattr(network, "forward_intermediates"):
        raise ValueError(f"timm:{name}: gives no feature maps (it has no forward_intermediates)")
    return network


def _near(name: str) -> list[str]:
    """Names of which a message can show all."""
    import difflib

    import timm

    return difflib.get_close_matches(name.partition(".")[0], timm.list_models(), n=5, cutoff=0.3)


def _told(name: str, weights: WeightsFile) -> dict[str, Any]:
    """What the release's configuration says of how the network is made."""
    if not (weights.path / CONFIG).is_file():
        return {}
    config = read_config(weights.path, {"architecture": name.partition(".")[0]})
    shown = {key: x for key, x in config.get("pretrained_cfg", {}).items() if key in SHOWN}
    return {**config.get("model_args", {}), "pretrained_cfg_overlay": shown}


def _any_size(network: Any) -> bool:
    patches: Any = getattr(network, "patch_embed", None)
    if hasattr(patches, "strict_img_size"):
        return not patches.strict_img_size
    return not network.default_cfg.get("fixed_input_size", False)


def _normed(network: Any) -> bool:
    """Whether the last map goes through a norm of the network's own, as a transformer's does."""
    return isinstance(getattr(network, "norm", None), nn.Module) and hasattr(network, "blocks")
