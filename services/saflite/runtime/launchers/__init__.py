"""Places where services run: each starts, polls and stops the roles of a farm."""
