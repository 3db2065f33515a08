"""Ways of seeing: from rendered clips to tracks, one file a family."""
