"""The command line, the live screen, reports."""
