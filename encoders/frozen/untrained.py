"""A frozen encoder with the weights that it had before any training: the control of pretraining."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import torch
from torch import nn

from encoders.frozen.base import FrozenEncoder
from encoders.identity import IdentifiedEncoder
from encoders.release import WeightsFile

SCALE = re.compile(r"norm|scale|gamma|lambda")  # vectors that multiply, which begin at one
VERSION = 2  # raised when the same seed draws other weights
Network = TypeVar("Network", bound=nn.Module)
SPREAD = (
    0.02  # of weights that belong to no layer which could draw them (the usual of transformers)
)


def untrained(encoder: IdentifiedEncoder, seed: int) -> FrozenEncoder:
    """The encoder, its weights drawn anew in place.

    Layers draw theirs as torch does for a new one; weights outside of such layers (embeddings of
    positions, tokens) are normally distributed, and vectors that only scale are one.

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
    encoder.identity = replace(encoder.identity, weights_sha256=_word(seed))
    return encoder


def drawn_anew(network: Network, seed: int) -> Network:
    """A network with its weights drawn anew in place; see :func:`untrained`."""
    with torch.random.fork_rng([]), torch.no_grad():
        torch.manual_seed(seed)
        held = next(network.parameters(), None)
        where = "cpu" if held is None else held.device
        network.cpu()  # whose generator draws the same numbers whatever the device
        for module in network.modules():
            _draw(module)
        return network.to(where)


def fresh(build: Callable[[], Network], seed: int) -> tuple[Network, WeightsFile]:
    """A new network with weights of a seed, and what stands for the file of them.

    Args:
        build: makes the network.
        seed: of the weights; see :func:`untrained`.
    """
    with torch.random.fork_rng([]):
        network = drawn_anew(build(), seed)
    return network, WeightsFile(Path("no file"), _word(seed))


def _word(seed: int) -> str:
    return f"drawn anew by seed {seed}, version {VERSION}"


def _draw(module: nn.Module) -> None:
    reset = getattr(module, "reset_parameters", None)
    if callable(reset):
        reset()
    for name, weight in module.named_parameters(recurse=False):
        if weight.dim() <= 1 and SCALE.search(f"{type(module).__name__}.{name}".lower()):
            # also where a layer would begin near zero: a control whose blocks do nothing is none
            weight.fill_(0.0 if name == "bias" else 1.0)
        elif not callable(reset):
            weight.normal_(std=SPREAD)
