"""The books: a pure state machine over leases, rounds, confirmation, and the SQLite store beneath it."""
