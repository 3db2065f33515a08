"""Names of the smooth activations that networks may have."""

TANH, SOFTPLUS, SILU = "tanh", "softplus", "silu"
