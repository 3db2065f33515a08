"""The harder confusion scenes: drawn parameters, unequal masses, and what trackers do wrong."""
