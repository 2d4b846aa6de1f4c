"""One row of the parameter table."""

from __future__ import annotations

from typing import NamedTuple


class Parameter(NamedTuple):
    """One row of the table.

    `slot` names the place on the vehicle's board that takes value x `scale`; without one the modes read the parameter.
    Ranges are ArduPilot's, narrowed where this airframe cannot fly over the whole of it.
    """

    name: str
    default: float
    low: float
    high: float
    unit: str
    meaning: str
    slot: str = ""
    scale: float = 1.0
    reboot: bool = False
