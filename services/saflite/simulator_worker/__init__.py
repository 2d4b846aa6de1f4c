"""Turns a lease into a flight, inside a child process with deadlines."""
