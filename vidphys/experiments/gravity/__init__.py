"""Three bodies and more under pair forces: stability, inversion, transport, planning."""
