"""All hidden states of a model of transformers, each as ``(n, tokens, k)`` of whole clips.

Some models see a clip as pictures side by side, or first in space and then in time: their states
have frames, or places, in the axis of the batch. Here they are brought back to clips.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

PIXELS = ("pixel_values_videos", "pixel_values")  # what models call their input
SIDE_BY_SIDE = ("xclip_vision_model",)  # kinds that take the frames of all clips as one batch
SPACE_THEN_TIME = ("videoprism_vision_model",)
# kinds with a token a frame, after one of the class, which the last state lacks; their embedding
# lets a frame's neighbours in
FRAME_BY_FRAME = ("pe_video_encoder",)


def inputs_of(model: nn.Module) -> list[str]:
    """Names of what a model is called with."""
    from inspect import signature

    found = list(signature(model.forward).parameters)
    if not set(found) & set(PIXELS):
        raise ValueError(
            f"hf: a {type(model).__name__} does not see pictures (it takes {', '.join(found[:4])})"
        )
    return found


def states_of(
    model: nn.Module, name: str, pixels: Tensor, resized: bool = False
) -> tuple[Tensor, ...]:
    """All hidden states, that of the embedding first.

    Args:
        model: that sees pictures or clips.
        name: of its pixels among what it is called with.
        pixels: ``(n, 3, H, W)``, or ``(n, f, 3, H, W)`` of clips.
        resized: whether these are of another size or number than the model's own.

    Raises:
        ValueError: the model gives none.
    """
    config: Any = model.config
    if config.model_type in SIDE_BY_SIDE:
        n, frames = pixels.shape[:2]
        states = _called(model, name, pixels.flatten(0, 1), resized)
        return tuple(x[:, 1:].unflatten(0, (n, frames)).flatten(1, 2) for x in states)
    states = _called(model, name, pixels, resized)
    if config.model_type in FRAME_BY_FRAME:
        return tuple(x[:, 1:] for x in states[:-1]) + states[-1:]
    if config.model_type in SPACE_THEN_TIME:
        n, frames = pixels.shape[:2]
        spatial = config.num_spatial_layers + 1  # and the embedding
        own = [x.unflatten(0, (n, frames)).flatten(1, 2) for x in states[:spatial]]
        later = (x.unflatten(0, (n, -1)).transpose(1, 2).flatten(1, 2) for x in states[spatial:-1])
        return (*own, *later, states[-1])
    return states


def _called(model: nn.Module, name: str, pixels: Tensor, resized: bool) -> tuple[Tensor, ...]:
    flags = {"skip_predictor": True, "interpolate_pos_encoding": resized}
    more = {key: flag for key, flag in flags.items() if flag and key in inputs_of(model)}
    try:
        found = model(**{name: pixels}, output_hidden_states=True, return_dict=True, **more)
    except TypeError as error:
        what, said = type(model).__name__, str(error).partition("forward() ")[2]
        raise ValueError(f"hf: a {what} sees more than pictures ({said})") from error
    states = getattr(found, "reshaped_hidden_states", None) or found.hidden_states
    if not states:
        raise ValueError(f"hf: a {type(model).__name__} gives no hidden states")
    return tuple(states)
