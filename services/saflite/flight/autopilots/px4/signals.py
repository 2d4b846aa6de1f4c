"""The signals of a trace: the truth, what the autopilot says, and settings in force, all under common names."""

from __future__ import annotations

from collections.abc import Mapping

from saflite.contract.signals import SIGNALS
from saflite.flight.autopilots.px4.settings import shown_settings
from saflite.flight.autopilots.px4.vehicle import Vehicle

_NOT_WRITTEN = frozenset({"time_s"})


def trace_names(parameters: Mapping[str, float]) -> tuple[str, ...]:
    """Return the signals of a trace of a binary with these parameters: settings it does not have are left out."""
    have, told = Vehicle.slots(), shown_settings(parameters)
    return tuple(
        name
        for name in SIGNALS
        if name in have and name not in _NOT_WRITTEN and (name in told or not _is_setting(name))
    )


def _is_setting(name: str) -> bool:
    return (
        "_set_" in name
        or name in ("fence_enabled", "fence_on_set", "fence_type_set", "fence_action_set")
        or (name in ("fs_gps_action", "fs_throttle_enabled", "arming_checks_set", "altitude_source"))
    )
