"""How does it learn? Run config, recipes, SAC, replay buffer, callback, checkpoint, export."""
