"""What decides? Actions, observation, policy, validity band: numpy and onnxruntime alone."""
