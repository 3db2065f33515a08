"""Heat baths and drives: temperature, injection, steady states."""
