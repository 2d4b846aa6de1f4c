"""All modes by ArduCopter's names."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from saflite.contract.errors import Refused
from saflite.contract.signals import MODES
from saflite.flight.autopilots.reference.modes.base import Mode

if TYPE_CHECKING:
    from saflite.flight.autopilots.reference.autopilot import Autopilot


@cache
def mode_table() -> dict[str, type[Mode]]:
    """Return the modes this autopilot has."""
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

    modules = (stabilize, acro, alt_hold, auto, guided, loiter, rtl, circle, land, flip, brake)
    return {module.MODE.name: module.MODE for module in modules}


def make_mode(name: str, ap: Autopilot) -> Mode:
    """Return a fresh mode; raises Refused for a name this autopilot does not have."""
    table = mode_table()
    if name not in table:
        raise Refused("flight mode", expected=f"one of {', '.join(table)}", got=repr(name))
    return table[name](ap)


def mode_name(number: int) -> str:
    """Return the name of ArduCopter's mode number; empty for a mode this autopilot does not have."""
    return next((name for name in mode_table() if MODES[name] == number), "")
