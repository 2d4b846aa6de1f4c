"""Sensor faults by name: `SIM_*` parameters, and the names that all autopilots share (`flight/sensors/faults.py`)."""

from __future__ import annotations

from functools import cache

from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference.parameters import parameter_table
from saflite.flight.sensors.sensors import FAULT

BEYOND_SENSORS = {"radio_loss": "SIM_RC_FAIL", "engine_failure": "SIM_ENGINE_FAIL", "wind": "SIM_WIND_SPD"}


@cache
def shared_names() -> dict[str, str]:
    """Return the faults named for all autopilots, and the parameter that makes each."""
    rows = parameter_table().values()
    return {row.slot.removeprefix(FAULT): row.name for row in rows if row.slot.startswith(FAULT)} | BEYOND_SENSORS


def fault_parameter(name: str, where: str) -> str:
    """Return the parameter that makes the fault; raises Refused for an unknown one."""
    parameter = shared_names().get(name, name)
    if not parameter.startswith("SIM_") or parameter not in parameter_table():
        rows = [row for row in parameter_table() if row.startswith("SIM_")]
        expected = f"one of {', '.join(shared_names())} or a SIM_ parameter"
        raise Refused("sensor fault", where=where, expected=expected, got=repr(name), known=(*shared_names(), *rows))
    return parameter


def fault_value(name: str, size: float) -> float:
    """Return the value of the parameter that makes a fault of this size: shared names count in units of their own."""
    return size / parameter_table()[shared_names()[name]].scale if name in shared_names() else size
