"""The extremes as a matrix of cells, each sound, warned of or refused; never silently wrong."""
