"""Identify a fish from recordings: parameters with their intervals."""
