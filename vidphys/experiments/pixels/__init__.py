"""Tables that draw clips and see them."""
