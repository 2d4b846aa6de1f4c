"""Orders whose numbers leave no doubt: an autopilot in the state for one has no reason to refuse it. Pure.

Numbers after MAVLink's common message set; what of it ArduCopter takes, and when, after its manual ("MAVLink commands
in guided mode", "Copter mission command list").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from saflite.contract.flight import Given
from saflite.contract.test_case import Stimulus
from saflite.flight.mission import to_local

ARM, TAKE_OFF, GO, TURN, SPEED, FLIP, BEGIN, HOME, PAUSE, FENCE = range(1, 11)
"""Codes of `plain_order`."""
HEIGHT_M, SPEED_MPS, NEAR_M = (2.0, 100.0), (0.5, 15.0), 1000.0


class PlainOrder(NamedTuple):
    """When one was given, which, and whether it was refused."""

    at_s: float
    code: int
    refused: bool


def plain_orders(asked: Sequence[Given], origin: tuple[float, float] | None) -> list[PlainOrder]:
    """Return the orders without doubt, in order of time; `origin` is latitude and longitude of the track's, in degrees.

    Without an origin orders to places are left out: nobody knows how far off they are.
    """
    coded = [(one, _code(one.stimulus, origin)) for one in asked]
    return [PlainOrder(one.stimulus.at_s, code, one.answer == "denied") for one, code in coded if code]


def _code(stimulus: Stimulus, origin: tuple[float, float] | None) -> int:
    if stimulus.kind == "mode":
        return FLIP if stimulus.name.upper() == "FLIP" else 0
    if stimulus.kind != "command":
        return 0
    numbers = (*stimulus.values, *(0.0,) * 7)[:7]
    if not all(map(math.isfinite, numbers)):
        return 0
    return _codes(numbers, origin).get(stimulus.name.upper().removeprefix("MAV_CMD_"), 0)


def _codes(numbers: tuple[float, ...], origin: tuple[float, float] | None) -> dict[str, int]:
    first, second, third, fourth = numbers[:4]
    here = first == 1.0 or _is_near(numbers[4], numbers[5], origin)
    goes = _is_near(numbers[4], numbers[5], origin) and second in (0.0, 1.0) and _within(numbers[6], HEIGHT_M)
    turns = 0.0 <= first <= 360.0 and second == 0.0 and third in (-1.0, 0.0, 1.0) and fourth in (0.0, 1.0)
    return {
        "COMPONENT_ARM_DISARM": ARM * (first == 1.0 and second == 0.0),
        "NAV_TAKEOFF": TAKE_OFF * _within(numbers[6], HEIGHT_M),
        "DO_REPOSITION": GO * goes,
        "CONDITION_YAW": TURN * turns,
        "DO_CHANGE_SPEED": SPEED * (first in (0.0, 1.0) and _within(second, SPEED_MPS)),
        "MISSION_START": BEGIN,
        "DO_SET_HOME": HOME * here,
        "DO_PAUSE_CONTINUE": PAUSE * (first in (0.0, 1.0)),
        "DO_FENCE_ENABLE": FENCE * (first in (0.0, 1.0)),
    }


def _within(value: float, span: tuple[float, float]) -> bool:
    return span[0] <= value <= span[1]


def _is_near(lat_deg: float, lon_deg: float, origin: tuple[float, float] | None) -> bool:
    if origin is None or not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0) or (lat_deg == 0.0 and lon_deg == 0.0):
        return False
    return math.hypot(*to_local(lat_deg, lon_deg, *origin)) <= NEAR_M
