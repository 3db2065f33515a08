"""Linear coupling: the factorial, parameter maps, and whether the factored form is needed."""
