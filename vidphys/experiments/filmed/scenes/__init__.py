"""Which scenes are filmed: each a function of a random generator, by name."""
