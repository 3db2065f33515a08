"""What is said of a diagnosis: words, data, forecasts, and the specification of a model."""
