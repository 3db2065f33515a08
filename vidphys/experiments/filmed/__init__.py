"""Filmed scenes: known motions seen as a phone sees them, and what a diagnosis makes of them."""
