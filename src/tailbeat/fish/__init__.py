"""Describe a fish: its numbers, its engine model, and the forces of the water on it."""
