"""The weak form: what accelerations along a path mean for the positions that were recorded."""
