"""Where are fish and target? Camera, tags, tracker, calibration."""
