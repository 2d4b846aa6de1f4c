"""The books as a pure state machine: journal, reducer, invariants, and what goes out with a commit."""
