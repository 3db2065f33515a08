"""From tracks to a start: the state that a law carries through what was seen."""
