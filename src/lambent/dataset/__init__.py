"""Training data: crops and clips rendered, kept, verified and read."""
