"""A frozen encoder with the weights that it had before any training: the control of pretraining."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import torch
from torch import nn

from encoders.frozen.base import FrozenEncoder
from encoders.identity import IdentifiedEncoder

Network = TypeVar("Network", bound=nn.Module)
SPREAD = (
    0.02  # of weights that belong to no layer which could draw them (the usual of transformers)
)


def untrained(encoder: IdentifiedEncoder, seed: int) -> FrozenEncoder:
    """The encoder, its weights drawn anew in place.

    Layers draw theirs as torch does for a new one; weights outside of such layers (embeddings of
    positions, tokens) are normally distributed.

    Args:
        encoder: one of ours.
        seed: of the weights; torch's global generator is left as it was.

    Raises:
        ValueError: the encoder shows no network.
    """
    if not isinstance(encoder, FrozenEncoder):
        raise ValueError(
            f"{encoder.identity.name}: only a FrozenEncoder can be had with random weights, got "
            f"{type(encoder).__name__}"
        )
    drawn_anew(encoder.network, seed)
    weights = f"drawn anew by seed {seed}"
    encoder.identity = replace(encoder.identity, weights_sha256=weights)
    return encoder


def drawn_anew(network: Network, seed: int) -> Network:
    """A network with its weights drawn anew in place; see :func:`untrained`."""
    with torch.random.fork_rng([]), torch.no_grad():
        torch.manual_seed(seed)
        for module in network.modules():
            _draw(module)
    return network


def _draw(module: nn.Module) -> None:
    reset = getattr(module, "reset_parameters", None)
    if callable(reset):
        reset()
        return
    for weight in module.parameters(recurse=False):
        weight.normal_(std=SPREAD)
