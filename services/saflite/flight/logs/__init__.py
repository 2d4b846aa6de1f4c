"""Flight logs as traces: ULog, DataFlash, and our own trace files."""
