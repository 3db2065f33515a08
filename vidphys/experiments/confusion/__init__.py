"""Confusion scenes: motions whose law is known, told apart from noisy positions alone."""
