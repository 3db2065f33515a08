"""Which of the things that were followed in a clip are bodies that a law moves."""
