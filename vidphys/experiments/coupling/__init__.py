"""Which power of the coupling holds, and laws that a model is wrong about."""
