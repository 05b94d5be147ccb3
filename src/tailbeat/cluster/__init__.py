"""Many trainings on one machine or a cluster: what to train, one trial, all trials, results."""
