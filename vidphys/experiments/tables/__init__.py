"""The study's tables that need no pixels: a file a family, and their pre-registered bars."""
