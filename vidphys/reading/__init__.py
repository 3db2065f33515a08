"""One way to read a clip: frames to tracks, states and forecasts, and how that is trained."""
