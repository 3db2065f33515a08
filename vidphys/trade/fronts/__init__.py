"""The fronts: a file each, which yields jobs that are timed side by side."""
