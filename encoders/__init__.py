"""Frames to feature maps: trained and frozen encoders. Knows no physics."""

from typing import TYPE_CHECKING

from registry import lazily

if TYPE_CHECKING:
    from encoders.arrays import FeatureArrays as FeatureArrays
    from encoders.cnn import ConvEncoder as ConvEncoder
    from encoders.features import Encoder as Encoder
    from encoders.features import FeatureMap as FeatureMap
    from encoders.frozen.base import FrozenEncoder as FrozenEncoder
    from encoders.frozen.catalogue import load_encoder as load_encoder
    from encoders.identity import EncoderIdentity as EncoderIdentity
    from encoders.jepa import EmaTarget as EmaTarget
    from encoders.jepa import ema_momentum as ema_momentum
    from encoders.jepa import variance_floor as variance_floor
    from encoders.manifests import FeatureRequest as FeatureRequest
    from encoders.manifests import StaleFeatures as StaleFeatures
    from encoders.release import WeightsMissing as WeightsMissing
    from encoders.store import FeatureStore as FeatureStore
    from encoders.weights import fetch as fetch
    from encoders.weights import find_weights as find_weights

HOMES = {
    "ConvEncoder": "encoders.cnn",
    "EmaTarget": "encoders.jepa",
    "Encoder": "encoders.features",
    "EncoderIdentity": "encoders.identity",
    "FeatureArrays": "encoders.arrays",
    "FeatureMap": "encoders.features",
    "FeatureRequest": "encoders.manifests",
    "FeatureStore": "encoders.store",
    "FrozenEncoder": "encoders.frozen.base",
    "StaleFeatures": "encoders.manifests",
    "WeightsMissing": "encoders.release",
    "ema_momentum": "encoders.jepa",
    "fetch": "encoders.weights",
    "find_weights": "encoders.weights",
    "load_encoder": "encoders.frozen.catalogue",
    "variance_floor": "encoders.jepa",
}
__all__ = [*HOMES]
__getattr__, __dir__ = lazily(__name__, HOMES)
