"""One export format per file, found by its place."""
