"""How well? Figures, benchmarks and the main job."""
