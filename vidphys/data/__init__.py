"""What a training is given: rendered clips or the user's, their labels, features and parts."""
