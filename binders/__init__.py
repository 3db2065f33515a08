"""Detections and features to tracks that keep identity."""

from binders.base import BINDERS, Binder, MotionTracks, Pictures
from binders.detect import detect
from binders.hand import assign, bind_by_acceleration
from binders.motion import MotionBinder
from binders.palette import track_by_palette
from binders.slots import SlotAttention, Slots
from binders.steadied import camera_path
from binders.tracker import SoftTracks, Tracker, extrapolate, follow_softly
from binders.tracks import Detections, Tracks

__all__ = [
    "BINDERS",
    "Binder",
    "Detections",
    "MotionBinder",
    "MotionTracks",
    "Pictures",
    "SlotAttention",
    "Slots",
    "SoftTracks",
    "Tracker",
    "Tracks",
    "assign",
    "bind_by_acceleration",
    "camera_path",
    "detect",
    "extrapolate",
    "follow_softly",
    "track_by_palette",
]
