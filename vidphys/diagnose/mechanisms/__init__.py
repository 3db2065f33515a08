"""Laws of motion fitted over a whole recording: laws, coordinates, and what a camera adds."""
