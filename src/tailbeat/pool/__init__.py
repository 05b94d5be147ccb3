"""The virtual pool: an independent, unsteady plant, its protocols and recorders."""
