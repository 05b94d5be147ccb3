"""Evaluation of a policy: trials in twin and pool, and their results."""
