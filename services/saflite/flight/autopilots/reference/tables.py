"""What the reference autopilot can be asked: parameters, commands, modes, faults. For strategies and `saflite list`."""

from __future__ import annotations

from saflite.contract.signals import MODES
from saflite.flight.autopilots.reference.commands import Command, command_table
from saflite.flight.autopilots.reference.defects import TABLE, Defect
from saflite.flight.autopilots.reference.modes.table import mode_table
from saflite.flight.autopilots.reference.parameter import Parameter
from saflite.flight.autopilots.reference.parameters import parameter_table

SIMULATION = "SIM_"


def parameters() -> dict[str, Parameter]:
    """Return every parameter on board: default, range, unit, whether it needs a restart. Without the world's own."""
    return {name: row for name, row in parameter_table().items() if not name.startswith(SIMULATION)}


def sensor_faults() -> dict[str, Parameter]:
    """Return the world's parameters (`SIM_*`): sensor faults, wind, engine and radio failure."""
    return {name: row for name, row in parameter_table().items() if name.startswith(SIMULATION)}


def commands() -> dict[str, Command]:
    """Return every MAV_CMD the autopilot knows by name (without `MAV_CMD_`), also those it always refuses."""
    return {row.name: row for row in command_table().values()}


def modes() -> dict[str, int]:
    """Return the flight modes and ArduCopter's numbers for them."""
    return {name: MODES[name] for name in mode_table()}


def defects() -> dict[str, Defect]:
    """Return the planted defects."""
    return dict(TABLE)
