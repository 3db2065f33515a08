"""Friction: dragged gravity, and the double pendulum of a physics engine."""
