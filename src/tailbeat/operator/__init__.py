"""What does the person at the pool see and say? The operator page and the tour of targets."""
