"""Scores learnt from flights: features of test cases, history, a forest."""
