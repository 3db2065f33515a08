"""What changes a speed at once: walls, floors, other bodies, a string that pulls taut."""
