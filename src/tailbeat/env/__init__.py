"""The task: world, reward, sensors, randomisation, and its interfaces to gymnasium and SB3."""
