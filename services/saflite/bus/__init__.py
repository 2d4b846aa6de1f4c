"""Topics as bytes: in memory, seeded faulty, and Zenoh (whose only importer is here)."""
