"""Frames to feature maps: trained and frozen encoders. Knows no physics."""

from encoders.features import Encoder, FeatureMap

__all__ = ["Encoder", "FeatureMap"]
