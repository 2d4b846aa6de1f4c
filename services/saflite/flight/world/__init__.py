"""The physical world: JSBSim, wind, contact, boxes. Knows no autopilot."""
