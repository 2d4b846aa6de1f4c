"""One scorer model per file, found by its place."""
