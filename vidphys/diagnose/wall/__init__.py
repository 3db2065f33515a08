"""One body beside a wall, fitted over the whole recording."""
