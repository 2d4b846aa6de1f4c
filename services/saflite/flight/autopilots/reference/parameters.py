"""On-board parameters: ArduPilot's names and units.

Setting one out of range is refused; the rest acts at once, or at the next start (`reboot`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache

from saflite.flight.autopilots.reference import parameters_flight, parameters_loops, parameters_simulation
from saflite.flight.autopilots.reference.parameter import Parameter
from saflite.flight.autopilots.reference.parameter_types import TYPES

STANDARD_DEGC, KELVIN = 15.0, 273.15
ROUNDED_UP = 0.01  # 1.995 is taken for 2: a float on the link may fall short of it


@cache
def parameter_table() -> dict[str, Parameter]:
    """Return all parameters by name."""
    rows = (*parameters_loops.ROWS, *parameters_flight.ROWS, *parameters_simulation.ROWS)
    table = {row.name: row for row in rows}
    assert len(table) == len(rows), "a parameter is listed twice"
    return table


def _kept(name: str, value: float) -> float:
    """Return the number that is kept: of a whole one the fraction is lost, as in AP_Param::set_float."""
    return value if name not in TYPES else float(math.trunc(value + math.copysign(ROUNDED_UP, value)))


class ParameterSet:
    """The values on board.

    Args:
        write: puts a number into a slot of the vehicle's board.
        unchecked: names whose range is not checked (a planted defect).
    """

    def __init__(self, write: Callable[[str, float], None], unchecked: Iterable[str] = ()) -> None:
        self._rows = parameter_table()
        self._write = write
        self.unchecked = frozenset(unchecked)
        self.values = {row.name: row.default for row in self._rows.values()}
        self.at_start: dict[str, float] = {}
        self.changes = 0
        for row in self._rows.values():
            self._apply(row)

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def set(self, name: str, value: float) -> str:
        """Set a parameter; return why it was refused, empty if it was taken.

        One that needs a restart is stored and shows, but acts only at the next start.
        """
        row = self._rows.get(name)
        if row is None:
            return f"no parameter {name}"
        if not math.isfinite(value):
            return f"{name} must be a finite number"
        if name not in self.unchecked and not row.low <= value <= row.high:
            return f"{name} must be {row.low:g} to {row.high:g} {row.unit}".rstrip()
        self.values[name] = _kept(name, value)
        self.changes += 1
        if not row.reboot:
            self._apply(row)
        return ""

    def start(self) -> None:
        """Let parameters that need a restart act."""
        for row in self._rows.values():
            self._apply(row)
        self.at_start = dict(self.values)
        warm = (self.values["GND_TEMP"] or STANDARD_DEGC) + KELVIN
        self._write("baro_gain", warm / (STANDARD_DEGC + KELVIN))

    def _apply(self, row: Parameter) -> None:
        if row.slot:
            self._write(row.slot, self.values[row.name] * row.scale)
