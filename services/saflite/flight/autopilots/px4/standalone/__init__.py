"""A finding on PX4 for its maintainers: what flies it without the farm, and what their ground station loads."""
