"""What did we measure? Recordings in, parameters with intervals out."""
