"""Aerialist: PX4-Avoidance on Gazebo in the competition's container, driven by its documented command line."""
