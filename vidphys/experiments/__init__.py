"""What is asked of the models, and how an answer becomes rows of a table."""
