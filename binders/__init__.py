"""Detections and features to tracks that keep identity."""

from binders.detect import detect
from binders.hand import bind_by_acceleration
from binders.tracks import Detections, Tracks

__all__ = ["Detections", "Tracks", "bind_by_acceleration", "detect"]
