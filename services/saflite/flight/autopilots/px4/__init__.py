"""PX4: a real autopilot in a process of its own, flown over MAVLink in lockstep with our world."""
