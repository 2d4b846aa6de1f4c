"""Checks of this installation, each with what was seen and how to mend it."""
