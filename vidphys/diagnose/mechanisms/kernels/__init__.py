"""Laws rolled step by step in loops that numba compiles."""
