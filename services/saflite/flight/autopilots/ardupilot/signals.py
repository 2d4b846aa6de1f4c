"""The signals of a trace: the truth, what the autopilot says, and settings in force, all under common names."""

from __future__ import annotations

from saflite.contract.signals import SIGNALS
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle

_NOT_WRITTEN = frozenset({"time_s"})


def trace_names() -> tuple[str, ...]:
    """Return the signals of a trace."""
    have = Vehicle.slots()
    return tuple(name for name in SIGNALS if name in have and name not in _NOT_WRITTEN)
