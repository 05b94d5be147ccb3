"""What is it? A fish as numbers, as an engine model, and the water on it."""
