"""What a frozen encoder knows of any target, layer by layer, beside what knows less than it."""
