"""The operator's side: the operator page, the station, and tours of targets."""
