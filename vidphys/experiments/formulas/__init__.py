"""Formulas found from noisy motion: laws to develop on, and laws drawn by seed to judge by."""
