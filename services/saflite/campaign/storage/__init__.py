"""The books on disk: SQLite, blobs, projections and their audits."""
