"""Read other people's files as recordings."""
