"""Our own flight stack: modes, missions, failsafes, parameters under ArduPilot names."""
