"""Commands that logs tell of, as the inputs that policies count: those that move a vehicle or order something."""

from __future__ import annotations

import math
from collections.abc import Sequence

from saflite.contract.test_case import Stimulus

NAMES: dict[int, str] = {
    16: "NAV_WAYPOINT",
    17: "NAV_LOITER_UNLIM",
    20: "NAV_RETURN_TO_LAUNCH",
    21: "NAV_LAND",
    22: "NAV_TAKEOFF",
    34: "DO_ORBIT",
    115: "CONDITION_YAW",
    178: "DO_CHANGE_SPEED",
    179: "DO_SET_HOME",
    185: "DO_FLIGHTTERMINATION",
    192: "DO_REPOSITION",
    207: "DO_FENCE_ENABLE",
    208: "DO_PARACHUTE",
    209: "DO_MOTOR_TEST",
    218: "DO_AUX_FUNCTION",
    400: "COMPONENT_ARM_DISARM",
}
"""MAV_CMD by number (MAVLink, common.xml)."""
REFUSALS = frozenset({1, 2, 3, 4})
"""MAV_RESULT of what was not done: refused for now, denied, unsupported, failed (MAVLink, common.xml)."""


def command(at_s: float, number: int, values: Sequence[float]) -> Stimulus | None:
    """Return a command that was given as an input; None for one that orders nothing of the vehicle itself."""
    name = NAMES.get(number)
    if name is None:
        return None
    finite = tuple(float(value) if math.isfinite(value) else 0.0 for value in values)
    return Stimulus(at_s=at_s, kind="command", name=f"MAV_CMD_{name}", values=finite)
