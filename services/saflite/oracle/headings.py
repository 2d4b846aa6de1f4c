"""Orders to turn, as headings. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Given
from saflite.contract.test_case import DEFAULT_TARGET, TestCase
from saflite.flight.mission import to_local
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG
from saflite.oracle.orders import Array, _index, _is, _numbers, origin_of

SLOW_DPS = 15.0
LOOKED_AT_M = 20.0  # a place nearer than this has no sure heading


class Heading(NamedTuple):
    """An order to turn: when, to which heading, and the way round: 1 clockwise, -1 the other, 0 the shorter."""

    at_s: float
    deg: float
    way: int = 0


def headings(
    test_case: TestCase, given: Sequence[Given], track: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], times: Array
) -> list[Heading]:
    """Return what each CONDITION_YAW and DO_SET_ROI orders; relative ones count from the heading then.

    A turn by so many degrees is one clockwise where no way is given, as far as all round.
    Orders to turn slowly (2nd number, degrees a second) are left out: they may take minutes. An order to look at a
    place counts as the heading from where the vehicle is then; on other targets it may turn a gimbal, or follow.

    Args:
        track: position north and east in metres, heading in degrees, shape (moments,) each.
    """
    x_m, y_m, yaw_deg = track
    found = []
    for stimulus, _, _ in given:
        at, values = _index(times, stimulus.at_s), _numbers(stimulus)
        if _is(stimulus, "CONDITION_YAW"):
            angle, rate_dps, way, relative = values[:4]
            if 0.0 < rate_dps < SLOW_DPS:
                continue
            if relative:
                angle = float(yaw_deg[at]) + (-angle if way < 0 else angle)
                way = way or 1.0  # by so many degrees that way: ArduCopter turns by 359 all round
            found.append(Heading(stimulus.at_s, angle % 360.0, int(np.sign(way))))
        elif _is(stimulus, "DO_SET_ROI") and (values[4] or values[5]) and test_case.target.name == DEFAULT_TARGET:
            place = to_local(values[4], values[5], *(origin_of(test_case) or (HOME_LAT_DEG, HOME_LON_DEG)))
            north, east = place[0] - float(x_m[at]), place[1] - float(y_m[at])
            if np.hypot(north, east) >= LOOKED_AT_M:
                found.append(Heading(stimulus.at_s, float(np.degrees(np.arctan2(east, north))) % 360.0))
    return found
