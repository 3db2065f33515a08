"""Frozen public encoders, a file a model."""

from encoders.frozen.hiera import HieraEncoder, HieraSettings, load_hiera

__all__ = ["HieraEncoder", "HieraSettings", "load_hiera"]
