"""Finds fish and target: camera, tags, tracker, calibration."""
