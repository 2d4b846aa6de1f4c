"""Places in commands: PX4 counts heights above sea, a test case above home, as for every target; 0, 0 is here."""

from __future__ import annotations

import math
from collections.abc import Sequence

LATITUDE_AT, HEIGHT_AT = 4, 6  # among the numbers of these
_ABOVE_SEA = frozenset(
    {
        *("MAV_CMD_NAV_TAKEOFF", "MAV_CMD_DO_REPOSITION", "MAV_CMD_DO_ORBIT"),
        *("MAV_CMD_DO_SET_HOME", "MAV_CMD_DO_SET_ROI_LOCATION"),
    }
)
_HERE = frozenset({"MAV_CMD_NAV_TAKEOFF", "MAV_CMD_DO_REPOSITION", "MAV_CMD_DO_ORBIT"})


def placed(name: str, values: Sequence[float], home_up_m: float) -> tuple[float, ...]:
    """Return the numbers of a command as PX4 takes them; a height left out is 0 m above home, one that is NaN stays so.

    A latitude and longitude of 0, 0 are no place off Africa: to our vehicle and to ArduPilot they say here, to PX4 NaN
    does. Source: MAVLink common.xml (heights of a COMMAND_LONG are those of MAV_FRAME_GLOBAL), PX4 1.17 `Commander.cpp`
    and `navigator_main.cpp`. MAV_CMD_DO_CHANGE_ALTITUDE names its frame itself.
    """
    if name not in _ABOVE_SEA:
        return tuple(values)
    padded = [*values, *([0.0] * (HEIGHT_AT + 1))][: max(len(values), HEIGHT_AT + 1)]
    padded[HEIGHT_AT] += home_up_m
    if name in _HERE and padded[LATITUDE_AT:HEIGHT_AT] == [0.0, 0.0]:
        padded[LATITUDE_AT:HEIGHT_AT] = [math.nan, math.nan]
    return tuple(padded)
