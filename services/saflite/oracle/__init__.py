"""Judges flights: signal temporal logic over named signals, policies as data."""
