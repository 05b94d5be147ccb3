"""How does it learn? Sensors, randomisation, environment, curriculum, training."""
