"""Recorded motion: tables and clips, which body is which, and how noisy it is."""
