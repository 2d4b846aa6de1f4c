"""One worker loop for all pools, the books' service, launchers and the supervisor of what they start."""
