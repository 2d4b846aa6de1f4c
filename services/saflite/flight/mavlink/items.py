"""Mission items and orders to places as MAVLink carries them: places in degrees x 1e7, other numbers whole."""

from __future__ import annotations

import math
from collections.abc import Sequence

from saflite.contract.test_case import Mission, MissionItem

WAYPOINT, GLOBAL, GLOBAL_INT, GLOBAL_RELATIVE, GLOBAL_TERRAIN = 16, 0, 5, 3, 10
PLACES = frozenset(
    {
        *(16, 17, 18, 19, 21, 22, 31, 34, 82, 84, 85, 94),
        *(179, 192, 195, 201),
        *(5000, 5001, 5002, 5003, 5004, 5100),
    }
)
"""Commands whose 5th to 7th number are a place (MAVLink, common.xml: hasLocation)."""
ORDERED_PLACES = frozenset({179, 192, 195, 201})
"""Those that ArduPilot takes with their place as an order: DO_SET_HOME, DO_REPOSITION, DO_SET_ROI(_LOCATION)."""
INT32 = 2**31 - 1
FLOAT_FRAMES = {GLOBAL_INT: GLOBAL, 6: GLOBAL_RELATIVE, 11: GLOBAL_TERRAIN}


def float_frame(frame: int) -> int:
    """Return the float frame that an integer frame stands for."""
    return FLOAT_FRAMES.get(frame, frame)


def whole(command: int, value: float) -> int:
    """Return the 5th or 6th number of an item as MISSION_ITEM_INT carries it; NaN is 0, what is too large is cut."""
    if math.isnan(value):
        return 0
    return round(max(-INT32, min(INT32, value * 1e7 if command in PLACES else value)))


def command_int_fields(number: int, numbers: Sequence[float]) -> tuple[float, ...]:
    """Return the fields of COMMAND_INT from `frame` to `z` for an order to a place whose height counts from home."""
    padded = [*numbers, *([0.0] * 7)][:7]
    x, y = whole(number, padded[4]), whole(number, padded[5])
    return (GLOBAL_RELATIVE, number, 0, 0, *padded[:4], x, y, padded[6])


def home_item(lat_deg: float, lon_deg: float, altitude_m: float) -> MissionItem:
    """Return item 0 as ArduPilot has it."""
    return MissionItem(command=WAYPOINT, frame=GLOBAL, params=(0, 0, 0, 0, lat_deg, lon_deg, altitude_m))


def item_fields(mission: Mission, *, home: bool, not_given: float) -> list[tuple[float, ...]]:
    """Return the fields of MISSION_ITEM_INT from `frame` to `z` for every item, after the home place if `home`.

    `not_given` stands for numbers the mission leaves open: NaN, or 0 for those who refuse it.
    """
    first = (home_item(mission.home_lat_deg, mission.home_lon_deg, mission.home_alt_m),) if home else ()
    return [_fields(item, index, not_given) for index, item in enumerate((*first, *mission.items))]


def _fields(item: MissionItem, index: int, not_given: float) -> tuple[float, ...]:
    numbers = [not_given if value is None else float(value) for value in item.params]
    x, y = whole(item.command, numbers[4]), whole(item.command, numbers[5])
    return (item.frame, item.command, int(index == 0), 1, *numbers[:4], x, y, numbers[6])
