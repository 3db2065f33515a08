"""Tracks of known motions as tables, without a camera: what is said of them, and how surely."""
