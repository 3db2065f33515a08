"""Detections and features to tracks that keep identity."""

from binders.tracks import Detections, Tracks

__all__ = ["Detections", "Tracks"]
