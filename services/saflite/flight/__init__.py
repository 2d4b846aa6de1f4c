"""What flies: geometry, missions, planner, JSBSim world, sensors, autopilots. A library: no bus, no wall clock."""
