"""The signals a trace may hold: name, unit, meaning. Flights write these names, policies and recordings read them.

Angles are degrees; yaw is the compass heading (0 north, 90 east); positions are x north, y east, altitude up from
the take-off point. `*_est_*` is what the autopilot believes, the plain name is the truth of the world.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Kind = Literal["real", "flag", "code"]


class Signal(NamedTuple):
    """One row of the table; `kind` is real, flag (0 or 1) or code (a number from a closed list such as a mode)."""

    unit: str
    meaning: str
    kind: Kind = "real"


SIGNALS: dict[str, Signal] = {
    "x_m": Signal("m", "position north"),
    "y_m": Signal("m", "position east"),
    "altitude_m": Signal("m", "height above the take-off point"),
    "vx_mps": Signal("m/s", "velocity north"),
    "vy_mps": Signal("m/s", "velocity east"),
    "climb_mps": Signal("m/s", "vertical speed, up positive"),
    "roll_deg": Signal("deg", "roll angle"),
    "pitch_deg": Signal("deg", "pitch angle"),
    "yaw_deg": Signal("deg", "heading, 0..360"),
    "roll_rate_dps": Signal("deg/s", "roll rate"),
    "pitch_rate_dps": Signal("deg/s", "pitch rate"),
    "yaw_rate_dps": Signal("deg/s", "yaw rate"),
    "obstacle_distance_m": Signal(
        "m", "competition distance: to the full boxes in the plane, or above the top when over a box; 1000 if none"
    ),
    "contact": Signal("", "1 while touching the solid core of a box (0.8 x the seen box)", "flag"),
    "mode": Signal("", "flight mode, ArduCopter's numbers", "code"),
    "armed": Signal("", "1 while motors are armed", "flag"),
    "landed": Signal("", "1 while the autopilot believes to stand on the ground", "flag"),
    "throttle": Signal("", "collective command, 0..1"),
    "mission_item": Signal("", "index of the current mission item", "code"),
}

MODES: dict[str, int] = {
    "STABILIZE": 0,
    "ACRO": 1,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "CIRCLE": 7,
    "LAND": 9,
    "DRIFT": 11,
    "SPORT": 13,
    "FLIP": 14,
    "BRAKE": 17,
}
