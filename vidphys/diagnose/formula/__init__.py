"""A law in closed form: a short formula of the force along a coordinate, or that there is none."""
