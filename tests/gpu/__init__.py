"""What only a card can show; skipped without one, and run by ``make test-gpu``."""
