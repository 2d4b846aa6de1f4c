"""Reads a run folder for people: what was found, by which software, what it takes."""
