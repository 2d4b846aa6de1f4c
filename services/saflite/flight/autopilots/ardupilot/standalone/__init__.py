"""Findings as scripts for ArduPilot's maintainers: flown by their binary on its own physics, without the farm."""
