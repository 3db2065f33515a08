"""Frames to feature maps: trained and frozen encoders. Knows no physics."""

from encoders.cnn import ConvEncoder
from encoders.features import Encoder, FeatureMap
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.catalogue import load_encoder
from encoders.identity import EncoderIdentity
from encoders.jepa import EmaTarget, ema_momentum, variance_floor
from encoders.release import WeightsMissing
from encoders.store import FeatureRequest, FeatureStore, StaleFeatures
from encoders.weights import fetch, find_weights

__all__ = [
    "ConvEncoder",
    "EmaTarget",
    "Encoder",
    "EncoderIdentity",
    "FeatureMap",
    "FeatureRequest",
    "FeatureStore",
    "FrozenEncoder",
    "StaleFeatures",
    "WeightsMissing",
    "ema_momentum",
    "fetch",
    "find_weights",
    "load_encoder",
    "variance_floor",
]
