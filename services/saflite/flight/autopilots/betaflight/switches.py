"""Radio channels and what they switch: sticks on 1 to 4, on each other one a box (the firmware's word for a mode).

Channel numbers count from 1 in the firmware's order: roll, pitch, throttle, yaw, then its AUX channels.
"""

from __future__ import annotations

from typing import NamedTuple

ROLL, PITCH, THROTTLE, YAW = 1, 2, 3, 4
STICKS = {"RC1": "roll, above the centre is right", "RC2": "pitch, above the centre is forward (nose down)"}
STICKS |= {"RC3": "throttle", "RC4": "yaw, above the centre is clockwise"}
CHANNELS = 16
OFF_US, ON_US = 1000.0, 2000.0
CENTRE_US, IDLE_US = 1500.0, 1000.0
PULSE_LOW_US, PULSE_HIGH_US = 800.0, 2200.0
_RANGE = "1700 2100"


class Switch(NamedTuple):
    """A box on a channel of its own: its permanent id, whether it needs the GPS build."""

    box: int
    channel: int
    meaning: str
    gps: bool = False


SWITCHES = {
    "ARM": Switch(0, 5, "arms and disarms"),
    "ANGLE": Switch(1, 6, "levels itself"),
    "HORIZON": Switch(2, 7, "levels itself with centred sticks"),
    "ALTHOLD": Switch(3, 8, "holds its height", gps=True),
    "POSHOLD": Switch(11, 9, "holds its place", gps=True),
    "RESCUE": Switch(46, 10, "GPS rescue: climbs, flies home, lands", gps=True),
    "FAILSAFE": Switch(27, 11, "the pilot's own failsafe switch"),
    "AIRMODE": Switch(28, 12, "full control at zero throttle"),
    "CRASHFLIP": Switch(35, 14, "turns over after a crash"),
    "PARALYZE": Switch(45, 15, "disables the vehicle until it is powered again"),
    "ACROTRAINER": Switch(47, 16, "limits the lean angle in ACRO"),
}

MODES = {"ACRO": 1, "ANGLE": 0, "ALTHOLD": 2, "RESCUE": 6, "POSHOLD": 16, "HORIZON": 30, "FAILSAFE": 31}
"""Modes by the numbers that the trace holds (native/telemetry.c): ArduCopter's where there is one of that meaning."""

_OF_MODE: dict[str, tuple[str, ...]] = {
    "ACRO": (),
    "ANGLE": ("ANGLE",),
    "HORIZON": ("HORIZON",),
    "ALTHOLD": ("ANGLE", "ALTHOLD"),
    "POSHOLD": ("ANGLE", "ALTHOLD", "POSHOLD"),
    "RESCUE": ("ANGLE", "RESCUE"),
}


def pilot_modes(gps: bool) -> tuple[str, ...]:
    """Return the modes that a pilot can switch to."""
    return tuple(mode for mode, on in _OF_MODE.items() if gps or not any(SWITCHES[name].gps for name in on))


def mode_channels(mode: str) -> dict[int, float]:
    """Return channel to pulse of the switches that make a mode."""
    on = _OF_MODE[mode]
    names = {name for switched in _OF_MODE.values() for name in switched}
    return {SWITCHES[name].channel: ON_US if name in on else OFF_US for name in names}


def switch_lines(gps: bool) -> list[str]:
    """Return the lines that put each box on its channel."""
    have = [switch for switch in SWITCHES.values() if gps or not switch.gps]
    return [f"aux {slot} {one.box} {one.channel - 5} {_RANGE} 0 0" for slot, one in enumerate(have)]
