"""Our fast paths beside their peers: `python -m benchmarks`."""
