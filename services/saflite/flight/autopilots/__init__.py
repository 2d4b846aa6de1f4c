"""Autopilots, one module or package each."""
