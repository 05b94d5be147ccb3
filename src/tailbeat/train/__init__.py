"""Training: run config, recipes, SAC, replay buffer, callback, checkpoint, export."""
