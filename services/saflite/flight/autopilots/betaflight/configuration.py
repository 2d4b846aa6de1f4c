"""How a vehicle is set up before it flies: the F450's tune, its ports and switches, then the test case's settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Refused, Unavailable
from saflite.flight.autopilots.betaflight import user_memory
from saflite.flight.autopilots.betaflight.cli import CommandLine
from saflite.flight.autopilots.betaflight.firmware import CLOCK_LIBRARY, Variant, listing
from saflite.flight.autopilots.betaflight.process import FirmwareDied, start
from saflite.flight.autopilots.betaflight.settings import BetaflightSetting, read_settings
from saflite.flight.autopilots.betaflight.switches import switch_lines
from saflite.flight.autopilots.betaflight.vehicle import Vehicle
from saflite.flight.mending import builds_firmware

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
    "max_aux_channels": 14,  # boards' default; the simulator build's 6 would leave half the switches unheard
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


class Memory(NamedTuple):
    """The firmware's memory of settings; which of those given it does not hold at the next power-up."""

    eeprom: bytes
    lost: tuple[str, ...] = ()


def configure(variant: Variant, parameters: Mapping[str, float], folder: Path, base: bytes = b"") -> Memory:
    """Give settings by the command line, beside those of `base` if it is not empty; save, read after a power-up.

    Raises:
        Refused: a setting or a value it does not take, or it cannot read `base`.
        FirmwareDied: it dies of one.
        Unavailable: it cannot be started, or dies of its own defaults.
    """
    (folder / EEPROM).unlink(missing_ok=True)
    if base:
        (folder / EEPROM).write_bytes(base)
    with _command_line(variant, folder, bare=not base) as line:
        if base:
            user_memory.check_taken(base, (folder / EEPROM).read_bytes())
        line.configure(lines(variant, parameters))
    eeprom = (folder / EEPROM).read_bytes()
    if not parameters:
        return Memory(eeprom)
    with _command_line(variant, folder) as line:
        return Memory(eeprom, tuple(_lost(line, known_settings(variant), parameters)))


@contextmanager
def _command_line(variant: Variant, folder: Path, *, bare: bool = False) -> Iterator[CommandLine]:
    """Start the firmware and open its command line; `bare`: with its own defaults, which it cannot die of."""
    firmware = start(variant.binary, CLOCK_LIBRARY, folder)
    vehicle = Vehicle(0)
    try:
        try:
            line = CommandLine(vehicle, firmware)
        except FirmwareDied as fault:
            if not bare:
                raise
            again = f"{builds_firmware(variant.name)} builds it again"
            raise Unavailable(f"{variant.binary} does not run here ({fault}): {again}") from fault
        yield line
    finally:
        firmware.close()


def _lost(line: CommandLine, known: Mapping[str, BetaflightSetting], given: Mapping[str, float]) -> Iterator[str]:
    for name, value in given.items():
        told = next((one for one in read_settings(line.ask(f"get {name}")) if one.name == name), None)
        if told is None or known[name].value_text(told.default) != known[name].value_text(value):
            yield name
