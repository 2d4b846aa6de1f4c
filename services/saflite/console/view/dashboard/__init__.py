"""The browser's view of runs: live figures, finds, workers, orders."""
