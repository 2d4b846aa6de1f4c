"""One target (vehicle and autopilot) per file, found by its place."""
