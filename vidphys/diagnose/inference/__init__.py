"""Which terms: the menu, the search through it, and the numbers of what was found."""
