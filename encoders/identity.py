"""Which encoder made a feature, exactly: what a feature store files it under."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EncoderIdentity:
    """Everything about an encoder that its features depend on.

    Args:
        name: the adapter.
        code_version: of the adapter; raised whenever its output changes.
        weights_sha256: hash of the file that it was loaded from.
        preprocessing: how frames became the network's input, in words.
        layer: what is read.
        resolution: pixels of the longer side of the network's input.
        dtype: of the computation.
    """

    name: str
    code_version: int
    weights_sha256: str
    preprocessing: str
    layer: str
    resolution: int
    dtype: str
