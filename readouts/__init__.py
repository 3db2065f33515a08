"""Tracks and feature maps to phase-space states: attention, differencing, shooting."""
