"""Faults that can be given to the vehicle: of its sensors, motors and radio link, and the wind."""

from __future__ import annotations

from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.flight.autopilots.betaflight.vehicle import Vehicle
from saflite.flight.sensors.faults import FAULTS, Fault

_ABSENT = ("compass", "battery", "gps_satellites", "gps_loss", "baro_loss")  # nothing of it reaches the simulator build
LINK_ALIVE, LINK_SILENT, LINK_BAD_PULSES = 0, 1, 2
BAD_PULSE_US = 800.0
MOTORS = 4


class BetaflightFault(NamedTuple):
    """A fault beside those of `flight/sensors/faults.py`: what it is, and the slot of the bridge that makes it."""

    fault: Fault
    slot: str = ""


OWN: dict[str, BetaflightFault] = {
    "gyro_stuck": BetaflightFault(Fault("", 0, 1, "gyro repeats its last reading"), "gyro_stuck"),
    "gyro_limit": BetaflightFault(Fault("deg/s", 0, 2000, "gyro saturates here, 0 never"), "gyro_limit_dps"),
    "accelerometer_stuck": BetaflightFault(
        Fault("", 0, 1, "accelerometer repeats its last reading"), "accelerometer_stuck"
    ),
    "baro_frozen": BetaflightFault(Fault("", 0, 1, "barometer repeats its last reading"), "fault_baro_loss"),
    "gps_frozen": BetaflightFault(Fault("", 0, 1, "GPS repeats its last position and velocity"), "gps_frozen"),
    "gps_drift_north": BetaflightFault(Fault("m/s", -10, 10, "GPS position drifts north"), "gps_drift_north"),
    "gps_drift_east": BetaflightFault(Fault("m/s", -10, 10, "GPS position drifts east"), "gps_drift_east"),
    "motor_swap": BetaflightFault(Fault("", 0, 43, "two motors swapped, tens and ones; 0 none"), "motor_swap"),
    "motor_lag": BetaflightFault(Fault("s", 0, 0.5, "motors follow later, time constant"), "motor_lag_s"),
    "motor_share": BetaflightFault(Fault("", 0, 1, "share of its command that the failed motor keeps")),
    "motor_failed": BetaflightFault(Fault("", 0, MOTORS, "number of the motor that fails, 0 none"), "motor_failed"),
    "radio_loss": BetaflightFault(Fault("", 0, 2, "radio link: 1 goes silent, 2 gives pulses out of range, 0 is well")),
    "wind": BetaflightFault(Fault("m/s", 0, 15, "steady wind from the north in place of the scenario's")),
}
WHOLE = frozenset({"gyro_stuck", "accelerometer_stuck", "baro_frozen", "gps_frozen", "motor_failed", "radio_loss"})
PAIRS = (0.0, 12.0, 13.0, 14.0, 23.0, 24.0, 34.0)


def known_faults(gps: bool) -> dict[str, Fault]:
    """Return the faults that can reach the firmware, by name."""
    shared = {name: fault for name, fault in FAULTS.items() if not name.startswith(_ABSENT)}
    every = {**shared, **{name: own.fault for name, own in OWN.items()}}
    return {name: fault for name, fault in every.items() if gps or not name.startswith("gps_")}


def check_fault(name: str, values: tuple[float, ...], gps: bool, where: str) -> None:
    """Raise Refused for an unknown fault, or a size that makes no sense."""
    fault = known_faults(gps).get(name)
    if fault is None:
        raise Refused("sensor fault", where=where, expected=f"one of {', '.join(known_faults(gps))}", got=repr(name))


def bounded(fault: Fault, size: float) -> float:
    """Return the size brought into the fault's range: what leaves it is no harsher world."""
    return min(fault.high, max(fault.low, size))


def set_fault(vehicle: Vehicle, name: str, size: float) -> None:
    """Put a fault of sensors or motors on the vehicle."""
    if name in FAULTS:
        vehicle.sensors.set_fault(name, size)
    elif name == "motor_share":
        vehicle["motor_failed_share"] = size
    elif name == "motor_swap":
        vehicle["motor_swap"] = min(PAIRS, key=lambda pair: abs(pair - size))
    else:
        vehicle[OWN[name].slot] = float(round(size)) if name in WHOLE else size
