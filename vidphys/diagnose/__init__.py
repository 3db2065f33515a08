"""What a scene requires, found from recorded motion."""
