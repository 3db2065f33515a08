"""Kinds of data sets: each turns a path into clips with what is known of them."""
