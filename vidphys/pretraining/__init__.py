"""Self-supervised pretraining of the tiny encoders that the package ships, a file an objective."""
