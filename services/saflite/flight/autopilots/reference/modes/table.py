"""All modes by ArduCopter's names."""

from __future__ import annotations

from functools import cache

from saflite.contract.errors import Refused
from saflite.contract.signals import MODES
from saflite.flight.autopilots.reference.flight_stack import FlightStack
from saflite.flight.autopilots.reference.modes import (
    acro,
    alt_hold,
    auto,
    brake,
    circle,
    flip,
    guided,
    land,
    loiter,
    rtl,
    stabilize,
)
from saflite.flight.autopilots.reference.modes.base import Mode


@cache
def mode_table() -> dict[str, type[Mode]]:
    """Return the modes this autopilot has."""
    modules = (stabilize, acro, alt_hold, auto, guided, loiter, rtl, circle, land, flip, brake)
    return {module.MODE.name: module.MODE for module in modules}


def make_mode(name: str, ap: FlightStack) -> Mode:
    """Return a fresh mode; raises Refused for a name this autopilot does not have."""
    table = mode_table()
    if name not in table:
        raise Refused("flight mode", expected=f"one of {', '.join(table)}", got=repr(name))
    return table[name](ap)


def mode_name(number: int) -> str:
    """Return the name of ArduCopter's mode number; empty for a mode this autopilot does not have."""
    return next((name for name in mode_table() if MODES[name] == number), "")
