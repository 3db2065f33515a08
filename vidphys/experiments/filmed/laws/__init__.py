"""The laws that filmed bodies move by: exact paths in metres from a few numbers."""
