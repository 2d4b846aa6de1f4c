"""One worker loop for all pools, the books' service, and the launcher of local processes."""
