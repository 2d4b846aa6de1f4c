"""How a vehicle is set up before it flies: the F450's tune, its ports and switches, then the test case's settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from saflite.contract.errors import Refused
from saflite.flight.autopilots.betaflight.cli import CommandLine
from saflite.flight.autopilots.betaflight.firmware import CLOCK_LIBRARY, Variant, listing
from saflite.flight.autopilots.betaflight.process import start
from saflite.flight.autopilots.betaflight.settings import BetaflightSetting
from saflite.flight.autopilots.betaflight.switches import switch_lines
from saflite.flight.autopilots.betaflight.vehicle import Vehicle

EEPROM = "eeprom.bin"
HOVER_US = 1420

# Stock gains oscillate on the F450, whose motors take 45 ms to follow: a limit cycle of 5 Hz.
TUNE: dict[str, float] = {
    "d_roll": 55,
    "d_max_roll": 55,
    "d_pitch": 60,
    "d_max_pitch": 60,
    "i_roll": 40,
    "i_pitch": 40,
    "angle_p_gain": 35,
    "pid_process_denom": 4,  # 2 kHz: enough for sensors at 400 Hz
    "pwr_on_arm_grace": 0,
}
TUNE_GPS: dict[str, float] = {"ap_hover_throttle": HOVER_US}
_PORTS = ("serial UART3 1 115200 57600 0 115200", "serial UART4 1 115200 57600 0 115200")
_GPS = ("serial UART2 2 115200 57600 0 115200", "feature GPS")


def known_settings(variant: Variant) -> dict[str, BetaflightSetting]:
    """Return name to setting of a build."""
    return {setting.name: setting for setting in listing(variant).settings}


def tune(variant: Variant) -> dict[str, float]:
    """Return the settings that make the F450 fly well."""
    wanted = TUNE | (TUNE_GPS if variant.gps else {})
    known = known_settings(variant)
    return {name: value for name, value in wanted.items() if name in known}


def lines(variant: Variant, parameters: Mapping[str, float]) -> list[str]:
    """Return the lines for the command line; raises Refused for a setting the build does not have."""
    known = known_settings(variant)
    said = [*_PORTS, *(_GPS if variant.gps else ()), *switch_lines(variant.gps)]
    if "blackbox_device" in known:
        said.append("set blackbox_device = NONE")  # a file that forks would share
    for name, value in {**tune(variant), **parameters}.items():
        if name not in known:
            raise Refused(f"parameter {name}", expected="a setting of this build", got="none of that name")
        said.append(f"set {name} = {known[name].value_text(value)}")
    return said


def configure(variant: Variant, parameters: Mapping[str, float], folder: Path) -> bytes:
    """Return the firmware's memory of settings after they were given by its command line and saved.

    Raises:
        Refused: a setting or a value it does not take.
        FirmwareDied: it dies of one.
        Unavailable: it cannot be started.
    """
    (folder / EEPROM).unlink(missing_ok=True)
    firmware = start(variant.binary, CLOCK_LIBRARY, folder)
    vehicle = Vehicle(0)
    try:
        CommandLine(vehicle, firmware).configure(lines(variant, parameters))
    finally:
        firmware.close(vehicle.pid)
    return (folder / EEPROM).read_bytes()
