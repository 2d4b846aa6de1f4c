"""Scores test cases before flight; models are swapped live."""
