"""Measured points of cost and accuracy, and choosing from them."""
