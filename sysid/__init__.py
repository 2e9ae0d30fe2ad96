"""Flight logs, identification and model-form uncertainty. Knows nothing of JSBSim."""
