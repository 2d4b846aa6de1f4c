"""PX4's modes under the common names, as logs are read: position mode is LOITER, hold is BRAKE, orbit is CIRCLE."""

from __future__ import annotations

from saflite.contract.signals import MODES as COMMON_MODES

OTHER = -1.0
MANUAL, ALTITUDE, POSITION, AUTO, ACRO, OFFBOARD, STABILIZED = range(1, 8)  # PX4_CUSTOM_MAIN_MODE
ORBIT, SLOW = 1, 2  # sub modes of POSITION
TAKEOFF, HOLD, MISSION, RETURN, LAND, PRECISION_LAND = 2, 3, 4, 5, 6, 9  # sub modes of AUTO
NUMBERS: dict[str, tuple[float, float]] = {
    "STABILIZE": (STABILIZED, 0),
    "ALT_HOLD": (ALTITUDE, 0),
    "LOITER": (POSITION, 0),
    "BRAKE": (AUTO, HOLD),
    "AUTO": (AUTO, MISSION),
    "RTL": (AUTO, RETURN),
    "LAND": (AUTO, LAND),
    "ACRO": (ACRO, 0),
}
"""The numbers of DO_SET_MODE for the modes that can be asked for."""
_SHOWN = {
    (MANUAL, 0): "STABILIZE",
    (OFFBOARD, 0): "GUIDED",
    (POSITION, ORBIT): "CIRCLE",
    (POSITION, SLOW): "LOITER",
    (AUTO, TAKEOFF): "GUIDED",
    (AUTO, PRECISION_LAND): "LAND",
    **{numbers: name for name, numbers in NUMBERS.items()},
}
MODES = {name: COMMON_MODES[name] for name in dict.fromkeys(_SHOWN.values())}
"""Modes of the trace."""


def shown(custom_mode: int) -> float:
    """Return the common number for the `custom_mode` of a heartbeat."""
    name = _SHOWN.get(pair(custom_mode))
    return OTHER if name is None else float(MODES[name])


def pair(custom_mode: int) -> tuple[int, int]:
    """Return main and sub mode."""
    return custom_mode >> 16 & 0xFF, custom_mode >> 24


def arms_in(name: str) -> str:
    """Return the mode in which to arm for one: in those that bring it down PX4 does not (`mode_requirements.cpp`)."""
    return "BRAKE" if name in ("RTL", "LAND") else name


def custom(name: str) -> int:
    """Return the `custom_mode` of a mode that can be asked for."""
    main, sub = NUMBERS[name]
    return int(main) << 16 | int(sub) << 24
