"""Detections and features to tracks that keep identity."""

from binders.detect import detect
from binders.hand import assign, bind_by_acceleration
from binders.motion import MotionSettings, MotionTracks, bind_motion, camera_path
from binders.palette import track_by_palette
from binders.slots import SlotAttention, Slots
from binders.tracker import SoftTracks, Tracker, extrapolate, follow_softly
from binders.tracks import Detections, Tracks

__all__ = [
    "Detections",
    "MotionSettings",
    "MotionTracks",
    "SlotAttention",
    "Slots",
    "SoftTracks",
    "Tracker",
    "Tracks",
    "assign",
    "bind_by_acceleration",
    "bind_motion",
    "camera_path",
    "detect",
    "extrapolate",
    "follow_softly",
    "track_by_palette",
]
