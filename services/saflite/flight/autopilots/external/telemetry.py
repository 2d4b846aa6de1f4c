"""What an autopilot says over MAVLink, as slots of the trace; its last word on each stays."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import msgspec

from saflite.contract.flight import TraceMessage
from saflite.flight.autopilots.external.vehicle import LockstepVehicle
from saflite.flight.heights import HOME_STEP_M
from saflite.flight.mission import to_local

ON_GROUND, TAKING_OFF = 1, 3  # MAV_LANDED_STATE
BARO, RECEIVER, PREARM = 8, 65536, 268435456  # MAV_SYS_STATUS_SENSOR bits
FIX_3D = 3
ERROR_UP_TO, WARNING_UP_TO = 3, 4  # MAV_SEVERITY
TEXT_CHARS_MAX, TEXTS_MAX = 12_800, 20_000
"""As long as 256 parts of a text can be (MAVLink, STATUSTEXT), and more than any autopilot says in a flight."""


class Telemetry:
    """Takes the vehicle's messages; for each kind in `kinds` there is a method of its name, in small letters after `_`.

    Args:
        vehicle: where the slots are.
        parameters: all that are known; kept up to date.
        home: latitude, longitude in degrees, height above sea in metres.
        kinds: names of the messages that are taken, beside texts and parameters.
        show: writes the settings in force into the slots; told how far home lies above that of take-off, too.
    """

    ready: bool = False

    def __init__(
        self,
        vehicle: LockstepVehicle,
        parameters: Mapping[str, float],
        home: tuple[float, float, float],
        kinds: Collection[str],
        show: Callable[[Any, Mapping[str, float], float], None],
    ) -> None:
        self.vehicle, self._home, self._show = vehicle, home, show
        self.parameters = dict(parameters)
        self.changes = 0  # of parameters, so far
        self.texts: list[TraceMessage] = []
        self.zero_s = 0.0  # simulated time at which the trace begins
        self._now_s = 0.0
        self._home_xy = (0.0, 0.0)
        self._start_up_m, self._home_up_m = home[2], 0.0  # home of take-off above sea, home above that
        self._takers: dict[str, Callable[[Any], None]] = {
            name: getattr(self, f"_{name.lower()}") for name in (*kinds, "PARAM_VALUE", "STATUSTEXT")
        }
        show(vehicle, self.parameters, 0.0)

    def take(self, message: Any, time_s: float) -> None:
        """Take a message of the vehicle, which came at `time_s` since power-up."""
        self._now_s = time_s
        taker = self._takers.get(message.get_type())
        if taker is not None:
            taker(message)

    def tick(self) -> None:
        """Work out what follows from the truth of this tick."""
        board = self.vehicle
        board["home_distance_m"] = math.hypot(board["x_m"] - self._home_xy[0], board["y_m"] - self._home_xy[1])

    def _local_position_ned(self, message: Any) -> None:
        self.vehicle.set(x_est_m=message.x, y_est_m=message.y, climb_est_mps=-message.vz)

    def _global_position_int(self, message: Any) -> None:
        """Count heights from home as it was at take-off: an order, or PX4 by itself, moves home in flight."""
        home_m = (message.alt - message.relative_alt) * 1e-3
        if self.vehicle["taken_off"] == 0.0:
            self._start_up_m = home_m
        self.vehicle["altitude_est_m"] = message.alt * 1e-3 - self._start_up_m
        if abs(home_m - self._start_up_m - self._home_up_m) > HOME_STEP_M:
            self._home_up_m = home_m - self._start_up_m
            self._show(self.vehicle, self.parameters, self._home_up_m)

    def _extended_sys_state(self, message: Any) -> None:
        landed = message.landed_state == ON_GROUND
        if not landed and self.vehicle["armed"] != 0.0:
            self.vehicle["taken_off"] = 1.0
        self.vehicle["landed"] = float(landed)

    def _show_health(self, message: Any) -> None:
        health = message.onboard_control_sensors_health
        self.vehicle.set(
            baro_ok=float(health & BARO != 0),
            rc_present=float(health & RECEIVER != 0),
            battery_v=message.voltage_battery * 1e-3,
        )

    def _home_position(self, message: Any) -> None:
        self._home_xy = to_local(message.latitude * 1e-7, message.longitude * 1e-7, self._home[0], self._home[1])

    def _value_of(self, message: Any) -> float:
        return float(message.param_value)

    def _param_value(self, message: Any) -> None:
        value = self._value_of(message)
        if self.parameters.get(message.param_id) != value:
            self.parameters[message.param_id] = value
            self.changes += 1
            self._show(self.vehicle, self.parameters, self._home_up_m)

    def _statustext(self, message: Any) -> None:
        text, severity = str(message.text).rstrip("\t\r\n"), int(message.severity)
        if message.chunk_seq and self.texts:  # the rest of a long one
            before = self.texts[-1].text
            if len(before) < TEXT_CHARS_MAX:
                self.texts[-1] = msgspec.structs.replace(self.texts[-1], text=before + text)
            return
        text = text if message.id else text.strip()
        kind = "error" if severity <= ERROR_UP_TO else "warning" if severity <= WARNING_UP_TO else "info"
        at_s = round(self._now_s - self.zero_s, 6)
        del self.texts[TEXTS_MAX - 1 :]  # of more than there may be the last stays, which may tell of the end
        self.texts.append(TraceMessage(at_s=at_s, text=text, severity=kind))  # type: ignore[arg-type]
