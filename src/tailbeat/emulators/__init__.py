"""Emulators of the hardware: servo, IMU, camera, faults, the whole rig; with real bytes."""
