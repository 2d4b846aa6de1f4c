"""Sensors of any autopilot, with every fault that can be put on them. Knows no autopilot."""
