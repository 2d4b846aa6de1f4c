"""Heights in commands: PX4 counts them above sea, a test case above home, as for every target."""

from __future__ import annotations

from collections.abc import Sequence

HEIGHT_AT = 6  # among the numbers of these
_ABOVE_SEA = frozenset(
    {
        *("MAV_CMD_NAV_TAKEOFF", "MAV_CMD_DO_REPOSITION", "MAV_CMD_DO_ORBIT"),
        *("MAV_CMD_DO_SET_HOME", "MAV_CMD_DO_SET_ROI_LOCATION"),
    }
)


def above_sea(name: str, values: Sequence[float], home_up_m: float) -> tuple[float, ...]:
    """Return the numbers of a command as PX4 takes them; one left out is 0 m above home, one that is NaN stays so.

    Source: MAVLink common.xml (heights of a COMMAND_LONG are those of MAV_FRAME_GLOBAL), PX4 1.17 `Commander.cpp` and
    `navigator_main.cpp`. MAV_CMD_DO_CHANGE_ALTITUDE names its frame itself.
    """
    if name not in _ABOVE_SEA:
        return tuple(values)
    padded = [*values, *([0.0] * (HEIGHT_AT + 1))][: max(len(values), HEIGHT_AT + 1)]
    padded[HEIGHT_AT] += home_up_m
    return tuple(padded)
