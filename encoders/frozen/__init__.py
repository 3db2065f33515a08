"""Frozen public encoders, a file a model, and the catalogue of them all."""

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.catalogue import ENCODERS, load_encoder, options_of
from encoders.frozen.dinov2 import DINOv2Encoder, DINOv2Settings, load_dinov2
from encoders.frozen.hiera import HieraEncoder, HieraSettings, load_hiera
from encoders.frozen.i3d import I3DEncoder, I3DSettings, load_i3d
from encoders.frozen.videomae import VideoMAEEncoder, VideoMAESettings, load_videomae
from encoders.frozen.vjepa2 import VJEPA2Encoder, VJEPA2Settings, load_vjepa2

__all__ = [
    "DINOv2Encoder",
    "DINOv2Settings",
    "ENCODERS",
    "FrozenEncoder",
    "HieraEncoder",
    "HieraSettings",
    "I3DEncoder",
    "I3DSettings",
    "VJEPA2Encoder",
    "VJEPA2Settings",
    "VideoMAEEncoder",
    "VideoMAESettings",
    "load_dinov2",
    "load_encoder",
    "load_hiera",
    "load_i3d",
    "load_videomae",
    "load_vjepa2",
    "options_of",
]
