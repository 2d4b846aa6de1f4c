"""A finding as a script of its own: a flight recorded at the firmware's link, and the program that replays it."""
