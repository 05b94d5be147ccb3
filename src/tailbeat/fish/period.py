"""The control period: how long a command of the robot, and a lift of its twin, is held."""

PERIOD = 0.02  # s
