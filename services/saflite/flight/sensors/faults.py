"""Faults that can be put on the sensors of any autopilot, by names of their own; targets map theirs onto these."""

from __future__ import annotations

from typing import NamedTuple


class Fault(NamedTuple):
    """One row: unit of the size, the sizes that make sense, the size that is no fault."""

    unit: str
    low: float
    high: float
    meaning: str
    healthy: float = 0.0


def _axes(name: str, size: float, unit: str, meaning: str) -> dict[str, Fault]:
    return {f"{name}_{axis}": Fault(unit, -size, size, f"{meaning}, {axis} axis") for axis in "xyz"}


FAULTS: dict[str, Fault] = {
    "gps_loss": Fault("", 0, 1, "GPS receiver silent"),
    "gps_satellites": Fault("", 0, 14, "satellites in view", 10.0),
    "gps_noise": Fault("m", 0, 10, "noise added to the GPS"),
    "gps_offset_north": Fault("m", -100, 100, "GPS offset north"),
    "gps_offset_east": Fault("m", -100, 100, "GPS offset east"),
    "gps_offset_up": Fault("m", -100, 100, "GPS offset up"),
    "gps_height_drift": Fault("m/s", -5, 5, "GPS height drift"),
    "baro_loss": Fault("", 0, 1, "barometer silent"),
    "baro_offset": Fault("m", -100, 100, "barometer offset"),
    "baro_drift": Fault("m/s", -5, 5, "barometer drift"),
    "baro_noise": Fault("m", 0, 5, "noise added to the barometer"),
    "compass_noise": Fault("gauss", 0, 0.5, "noise added to the compass"),
    **_axes("compass_offset", 0.5, "gauss", "compass offset"),
    "gyro_noise": Fault("rad/s", 0, 0.5235987755982, "noise added to the gyros"),
    **_axes("gyro_offset", 0.2, "rad/s", "gyro offset"),
    "accelerometer_noise": Fault("m/s/s", 0, 5, "noise added to the accelerometers"),
    **_axes("accelerometer_offset", 3, "m/s/s", "accelerometer offset"),
    "battery_voltage": Fault("V", 0, 17, "open voltage of the battery, 0 takes the model's"),
}
