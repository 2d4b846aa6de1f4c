"""How a process ended, in words."""

from __future__ import annotations

import signal


def how_ended(code: int) -> str:
    """Return an exit code of a process, below 0 for a signal, in words; most real-time signals have no name."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"
