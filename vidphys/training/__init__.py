"""Training: the one loop, its examples, and what each kind of model needs."""
