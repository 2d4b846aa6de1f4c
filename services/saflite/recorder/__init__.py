"""Writes flights and test cases in the formats people already open."""
