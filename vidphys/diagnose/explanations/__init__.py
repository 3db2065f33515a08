"""What explains a motion, each behind one protocol: the menu's terms, a wall."""
