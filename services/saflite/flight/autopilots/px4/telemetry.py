"""What PX4 says over MAVLink, as slots of the trace; its last word on each stays."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from saflite.contract.flight import TraceMessage
from saflite.flight.autopilots.px4 import modes, settings
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client
from saflite.flight.mission import to_local

RATES_HZ: dict[str, float] = {
    "HEARTBEAT": 25.0,
    "LOCAL_POSITION_NED": 25.0,
    "EXTENDED_SYS_STATE": 25.0,
    "POSITION_TARGET_LOCAL_NED": 10.0,
    "GLOBAL_POSITION_INT": 10.0,
    "RC_CHANNELS": 10.0,
    "GPS_RAW_INT": 10.0,
    "SYS_STATUS": 5.0,
    "HIGH_LATENCY2": 5.0,
    "MISSION_CURRENT": 5.0,
    "HOME_POSITION": 1.0,
}
ARMED, FAILSAFE = 128, 5  # MAV_MODE_FLAG_SAFETY_ARMED; MAV_STATE_CRITICAL
ON_GROUND, TAKING_OFF = 1, 3  # MAV_LANDED_STATE
BARO, RECEIVER, PREARM = 8, 65536, 268435456  # MAV_SYS_STATUS_SENSOR bits
GPS, RADIO, BATTERY, FENCE = 1, 256, 128, 2048  # HL_FAILURE_FLAG bits
FIX_3D, NOT_KNOWN = 3, 65535
ERROR_UP_TO, WARNING_UP_TO = 3, 4  # MAV_SEVERITY
FRESH_S = 2.0  # a receiver that has said nothing for longer is silent


class Telemetry:
    """Takes the vehicle's messages; `parameters` are all that are known, kept up to date."""

    def __init__(
        self, vehicle: Vehicle, client: Client, parameters: Mapping[str, float], home: tuple[float, float, float]
    ) -> None:
        self.vehicle, self._client, self._home = vehicle, client, home
        self.parameters = dict(parameters)
        self.texts: list[TraceMessage] = []
        self.zero_s = 0.0  # simulated time at which the trace begins
        self.ready = False
        self._prearm = self._homed = self._failsafe = False
        self._flags = 0
        self._gps_said_s = -math.inf
        self._now_s = 0.0
        self._home_xy = (0.0, 0.0)
        self._takers: dict[str, Callable[[Any], None]] = {
            name: getattr(self, f"_{name.lower()}") for name in (*RATES_HZ, "PARAM_VALUE")
        }
        settings.show(vehicle, self.parameters)

    def take(self, message: Any, time_s: float) -> None:
        """Take a message of the vehicle, which came at `time_s` since power-up."""
        self._now_s = time_s
        kind = message.get_type()
        if kind == "STATUSTEXT":
            self._text(message, time_s)
        elif kind in self._takers:
            self._takers[kind](message)

    def tick(self) -> None:
        """Work out what follows from the truth of this tick."""
        board = self.vehicle
        board["home_distance_m"] = math.hypot(board["x_m"] - self._home_xy[0], board["y_m"] - self._home_xy[1])
        if self._now_s - self._gps_said_s > FRESH_S:
            board["gps_ok"] = 0.0
        self.ready = self._prearm and self._homed

    # -- messages -------------------------------------------------------------------------------------------------

    def _heartbeat(self, message: Any) -> None:
        armed = float(message.base_mode & ARMED != 0)
        if armed == 0.0:
            self.vehicle["taken_off"] = 0.0
        self._failsafe = message.system_status == FAILSAFE
        taking_off = modes.pair(message.custom_mode) == (modes.AUTO, modes.TAKEOFF)
        self.vehicle.set(mode=modes.shown(message.custom_mode), armed=armed, takeoff=float(taking_off))
        self._show_failsafes()

    def _high_latency2(self, message: Any) -> None:
        self._flags = message.failure_flags
        self._show_failsafes()

    def _show_failsafes(self) -> None:
        """A failsafe counts by its causes: what has failed while one is in force."""
        causes = self._flags if self._failsafe else 0
        self.vehicle.set(
            failsafe_gps=float(causes & GPS != 0),
            failsafe_radio=float(causes & RADIO != 0),
            failsafe_battery=float(causes & BATTERY != 0),
            failsafe_fence=float(self._flags & FENCE != 0),
        )

    def _local_position_ned(self, message: Any) -> None:
        self.vehicle.set(x_est_m=message.x, y_est_m=message.y, climb_est_mps=-message.vz)

    def _position_target_local_ned(self, message: Any) -> None:
        aim_m = -message.z
        self.vehicle["altitude_target_m"] = aim_m if math.isfinite(aim_m) else self.vehicle["altitude_est_m"]

    def _global_position_int(self, message: Any) -> None:
        self.vehicle["altitude_est_m"] = message.relative_alt * 1e-3

    def _extended_sys_state(self, message: Any) -> None:
        landed = message.landed_state == ON_GROUND
        if not landed and self.vehicle["armed"] != 0.0:
            self.vehicle["taken_off"] = 1.0
        self.vehicle["landed"] = float(landed)

    def _rc_channels(self, message: Any) -> None:
        pulses = (message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw)
        if NOT_KNOWN not in pulses:
            self.vehicle.set(**{f"rc{number}_pwm": pulse for number, pulse in enumerate(pulses, 1)})

    def _gps_raw_int(self, message: Any) -> None:
        self._gps_said_s = self._now_s
        fixed = float(message.fix_type >= FIX_3D)
        self.vehicle.set(gps_altitude_m=message.alt * 1e-3 - self._home[2], gps_ok=fixed)

    def _sys_status(self, message: Any) -> None:
        health = message.onboard_control_sensors_health
        self._prearm = health & PREARM != 0
        self.vehicle.set(
            baro_ok=float(health & BARO != 0),
            rc_present=float(health & RECEIVER != 0),
            battery_v=message.voltage_battery * 1e-3,
        )

    def _mission_current(self, message: Any) -> None:
        self.vehicle["mission_item"] = float(message.seq)

    def _home_position(self, message: Any) -> None:
        self._homed = True
        self._home_xy = to_local(message.latitude * 1e-7, message.longitude * 1e-7, self._home[0], self._home[1])

    def _param_value(self, message: Any) -> None:
        value = self._client.decoded(message.param_value, message.param_type)
        if self.parameters.get(message.param_id) != value:
            self.parameters[message.param_id] = value
            settings.show(self.vehicle, self.parameters)

    def _text(self, message: Any, time_s: float) -> None:
        text, severity = str(message.text).strip(), int(message.severity)
        kind = "error" if severity <= ERROR_UP_TO else "warning" if severity <= WARNING_UP_TO else "info"
        self.texts.append(TraceMessage(at_s=round(time_s - self.zero_s, 6), text=text, severity=kind))  # type: ignore[arg-type]
