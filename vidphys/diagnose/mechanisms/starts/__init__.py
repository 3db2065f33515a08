"""Where fits begin: which laws are worth a try, and from what numbers."""
