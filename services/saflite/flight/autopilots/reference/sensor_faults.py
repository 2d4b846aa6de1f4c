"""Sensor faults by name: the `SIM_*` parameters, and short words for the common ones."""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference.parameters import parameter_table

WORDS = {
    "gps_loss": "SIM_GPS_DISABLE",
    "gps_satellites": "SIM_GPS_NUMSATS",
    "gps_noise": "SIM_GPS_NOISE",
    "gps_offset_north": "SIM_GPS_GLITCH_X",
    "gps_offset_east": "SIM_GPS_GLITCH_Y",
    "gps_offset_up": "SIM_GPS_GLITCH_Z",
    "baro_loss": "SIM_BARO_DISABLE",
    "baro_offset": "SIM_BARO_GLITCH",
    "baro_drift": "SIM_BARO_DRIFT",
    "compass_noise": "SIM_MAG_RND",
    "radio_loss": "SIM_RC_FAIL",
    "battery_voltage": "SIM_BATT_VOLTAGE",
    "engine_failure": "SIM_ENGINE_FAIL",
    "wind": "SIM_WIND_SPD",
}


def fault_parameter(name: str, where: str) -> str:
    """Return the parameter that makes the fault; raises Refused for an unknown one."""
    parameter = WORDS.get(name, name)
    if not parameter.startswith("SIM_") or parameter not in parameter_table():
        raise Refused(
            "sensor fault", where=where, expected=f"one of {', '.join(WORDS)} or a SIM_ parameter", got=repr(name)
        )
    return parameter
