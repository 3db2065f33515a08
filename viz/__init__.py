"""Records and arrays made visible: recordings, figures, the report."""
