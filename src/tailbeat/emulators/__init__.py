"""What stands in for hardware? Servo, IMU, camera, faults, the whole rig: real bytes."""
