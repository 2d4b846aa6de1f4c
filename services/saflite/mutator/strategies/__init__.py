"""One strategy per file, found by its place."""
