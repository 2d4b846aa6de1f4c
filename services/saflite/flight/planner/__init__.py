"""The local obstacle planner after PX4-Avoidance, and the kinematic vehicle that flies it cheaply."""
