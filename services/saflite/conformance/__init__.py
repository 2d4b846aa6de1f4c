"""What every member of a kind must keep to, as importable checks: run them over your own."""
