"""What stands in for water and hardware? An independent, unsteady plant."""
