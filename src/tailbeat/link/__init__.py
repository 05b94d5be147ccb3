"""Signed datagrams between station and fish, the clock comparison, the robot's status."""
