"""Settings of the battery that is read: ArduPilot has a set for each monitor, `BATT_`, `BATT2_`, ... `BATTA_`, ..."""

from __future__ import annotations

import math
from collections.abc import Mapping

from saflite.flight.logs.flight_log import Points

Told = tuple[float, str, float]
"""When a parameter was told, its name and value."""
_FIRST = "BATT_"
_PREFIXES = (_FIRST, *(f"BATT{number}_" for number in "23456789ABCDEFG"))
_LIMITS = ("LOW_VOLT", "LOW_MAH", "CRT_VOLT", "CRT_MAH")
_OF_FAILSAFES = (*_LIMITS, "FS_LOW_ACT", "FS_CRT_ACT")
_EARLIER_S = 3.0  # a failsafe is told after what caused it
_AT_REST = 1.0  # BATT_FS_VOLTSRC: by the voltage without load, which is reckoned


def of_monitor(told: list[Told], number: int) -> list[Told]:
    """Return what was told, settings of monitor `number` (from 0) under the names of the first one's."""
    if number == 0:
        return told
    own = _PREFIXES[min(number, len(_PREFIXES) - 1)]
    others = [one for one in told if not one[1].startswith(_FIRST) and not one[1].startswith(own)]
    return others + [(at, _FIRST + name.removeprefix(own), value) for at, name, value in told if name.startswith(own)]


def unknown_from(raised: Points, first: Mapping[str, float], number: int) -> list[Told]:
    """Return limits and actions as not known from the first failsafe on, where another monitor may have raised it.

    Args:
        raised: when the failsafe was raised (1) and ended (0).
        first: the parameters that the log begins with.
        number: the monitor that is read, from 0.
    """
    others = [prefix for at, prefix in enumerate(_PREFIXES) if at != number and first.get(f"{prefix}MONITOR", 0.0) > 0]
    limited = any(first.get(prefix + name, 0.0) > 0 for prefix in others for name in _LIMITS)
    at_s = next((at_s for at_s, value in raised if value > 0), None)
    if not limited or at_s is None:
        return []
    return [(at_s - _EARLIER_S, _FIRST + name, math.nan) for name in _OF_FAILSAFES]


def voltage_names(settings: Mapping[str, float]) -> tuple[str, ...]:
    """Return the fields of BAT, the first that is logged counts, that its limits are about (BATT_FS_VOLTSRC)."""
    return ("VoltR", "Volt") if settings.get(f"{_FIRST}FS_VOLTSRC") == _AT_REST else ("Volt",)
