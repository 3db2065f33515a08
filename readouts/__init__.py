"""Tracks and feature maps to phase-space states: attention, differencing, smoothing."""

from readouts.attention import AttentionReadout, confidence_at, distance_at
from readouts.base import FrameReadout, Readout
from readouts.differencing import backward_difference, central_difference
from readouts.kinds import READOUTS, MapShape, ReadoutKind, Recipe
from readouts.local import CellReader, LocalReadout, RefinedReadout
from readouts.pooled import PooledReadout, pooled_twin
from readouts.probes import StateProbe
from readouts.scale import FeatureScale
from readouts.smoothing import Smoothed, smooth
from readouts.soft_argmax import SoftArgmax, soft_argmax

__all__ = [
    "AttentionReadout",
    "CellReader",
    "FeatureScale",
    "FrameReadout",
    "LocalReadout",
    "MapShape",
    "PooledReadout",
    "READOUTS",
    "Readout",
    "ReadoutKind",
    "Recipe",
    "RefinedReadout",
    "SoftArgmax",
    "Smoothed",
    "StateProbe",
    "backward_difference",
    "central_difference",
    "confidence_at",
    "distance_at",
    "pooled_twin",
    "smooth",
    "soft_argmax",
]
