"""Control a fish: actions, observation, policy, band. Needs only numpy and onnxruntime."""
