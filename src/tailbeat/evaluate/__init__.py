"""How well does a policy do? Trials in twin and pool, and what they come to."""
