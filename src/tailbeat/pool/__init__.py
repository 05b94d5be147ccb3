"""What stands in for water? An independent, unsteady plant, its protocols and recorders."""
