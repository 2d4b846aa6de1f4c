"""Which inputs bear on which policy, known before any flight."""
