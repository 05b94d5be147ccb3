"""Benchmarks: how fast and how exact, compared with what."""
