"""The firmware's command line, over its first serial port: settings read, settings written, all saved."""

from __future__ import annotations

from collections.abc import Iterable

from saflite.contract.errors import Refused
from saflite.flight.autopilots.betaflight.process import Firmware, FirmwareDied
from saflite.flight.autopilots.betaflight.vehicle import EXITED, OK, PILOT, Vehicle

PROMPT = b"\r\n# "
START_STEPS, SILENCE_STEPS = 200, 60  # the command line opens after 100 ms without other bytes
TICK, TICKS_MAX = 4, 2000
ERROR = "###ERROR"


class CommandLine:
    """The command line of a firmware that has just been started and is not armed.

    Raises:
        FirmwareDied: it does not open.
    """

    def __init__(self, vehicle: Vehicle, firmware: Firmware) -> None:
        self._vehicle, self._firmware = vehicle, firmware
        if vehicle.connect(firmware.fd) != OK or vehicle.run(START_STEPS) != OK:
            raise FirmwareDied(f"the firmware did not start: {firmware.last_words()[-300:]!r}")
        vehicle.listen(PILOT)
        vehicle.say(PILOT, b"#")
        vehicle.run(SILENCE_STEPS)
        self._read("#")

    def ask(self, line: str) -> str:
        """Give one line and return what is said to it; raises FirmwareDied if the firmware dies of it."""
        self._vehicle.say(PILOT, line.encode("ascii", "replace") + b"\n")
        return self._read(line)

    def configure(self, lines: Iterable[str]) -> None:
        """Give lines and save them, which ends the firmware.

        Raises:
            Refused: one is not taken.
            FirmwareDied: the firmware dies.
        """
        for line in lines:
            said = self.ask(line)
            if ERROR in said:
                fix = "`saflite list parameters --target betaflight` shows settings and their ranges"
                raise Refused(
                    "Betaflight setting", expected="a line its command line takes", got=_trouble(said), fix=fix
                )
        self._vehicle.say(PILOT, b"save\n")
        for _ in range(TICKS_MAX):
            came = self._vehicle.run(TICK)
            if came == EXITED:
                return
            if came != OK:
                break
        raise FirmwareDied(f"the firmware did not save: {self._firmware.last_words()[-300:]!r}")

    def _read(self, line: str) -> str:
        heard = self._vehicle.heard(PILOT)
        for _ in range(TICKS_MAX):
            if heard.endswith(PROMPT):
                return heard.decode("ascii", "replace").replace("\r", "")
            if self._vehicle.run(TICK) != OK:
                break
            heard += self._vehicle.heard(PILOT)
        raise FirmwareDied(f"command line: no prompt after {line!r}: {self._firmware.last_words()[-300:]!r}")


def _trouble(said: str) -> str:
    """Return what was asked and why it was refused, in one line."""
    return "; ".join(line.strip("# ") for line in said.splitlines() if line.strip("# "))
