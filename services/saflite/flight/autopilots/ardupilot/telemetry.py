"""What the autopilot says over MAVLink, as slots of the trace; its last word on each stays."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from saflite.contract.flight import TraceMessage
from saflite.contract.signals import MODES as COMMON_MODES
from saflite.flight.autopilots.ardupilot import settings
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.mission import to_local

MODES: dict[str, int] = {
    **COMMON_MODES,
    "AUTOTUNE": 15,
    "POSHOLD": 16,
    "THROW": 18,
    "GUIDED_NOGPS": 20,
    "SMART_RTL": 21,
    "FLOWHOLD": 22,
    "ZIGZAG": 24,
    "TURTLE": 28,
}
RATES_HZ: dict[str, float] = {
    "HEARTBEAT": 25.0,
    "LOCAL_POSITION_NED": 25.0,
    "EXTENDED_SYS_STATE": 25.0,
    "RC_CHANNELS": 10.0,
    "GLOBAL_POSITION_INT": 10.0,
    "NAV_CONTROLLER_OUTPUT": 10.0,
    "GPS_RAW_INT": 5.0,
    "SYS_STATUS": 5.0,
    "EKF_STATUS_REPORT": 5.0,
    "MISSION_CURRENT": 5.0,
    "HOME_POSITION": 1.0,
    "FENCE_STATUS": 5.0,
}
ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
ON_GROUND, TAKING_OFF = 1, 3  # MAV_LANDED_STATE
BARO, RECEIVER, PREARM = 8, 65536, 268435456  # MAV_SYS_STATUS_SENSOR bits
EKF_NEEDED = 1 | 2 | 4 | 8 | 16 | 32  # EKF_STATUS_FLAGS: attitude, speeds, places, height
FIX_3D = 3
ERROR_UP_TO, WARNING_UP_TO = 3, 4  # MAV_SEVERITY
_RAISED = {"Radio Failsafe": "failsafe_radio", "EKF Failsafe: changed": "failsafe_gps"}
_CLEARED = {"Radio Failsafe Cleared": "failsafe_radio", "EKF Failsafe Cleared": "failsafe_gps"}


class Telemetry:
    """Takes the vehicle's messages; `parameters` are all that are known, kept up to date."""

    def __init__(self, vehicle: Vehicle, parameters: Mapping[str, float], home: tuple[float, float, float]) -> None:
        self.vehicle, self._home = vehicle, home
        self.parameters = dict(parameters)
        self.texts: list[TraceMessage] = []
        self.changes = 0  # of parameters, so far
        self.zero_s = 0.0  # simulated time at which the trace begins
        self.ready = False
        self._prearm = self._ekf = False
        self._home_xy = (0.0, 0.0)
        self._takers: dict[str, Callable[[Any], None]] = {
            name: getattr(self, f"_{name.lower()}") for name in (*RATES_HZ, "PARAM_VALUE")
        }
        settings.show(vehicle, self.parameters)

    def take(self, message: Any, time_s: float) -> None:
        """Take a message of the vehicle, which came at `time_s` since power-up."""
        kind = message.get_type()
        if kind == "STATUSTEXT":
            self._text(message, time_s)
        elif kind in self._takers:
            self._takers[kind](message)

    def tick(self) -> None:
        """Work out what follows from the truth of this tick."""
        board = self.vehicle
        board["home_distance_m"] = math.hypot(board["x_m"] - self._home_xy[0], board["y_m"] - self._home_xy[1])
        circling = board["mode"] == MODES["CIRCLE"]
        board["circle_radius_m"] = board["circle_radius_set_m"] if circling else 0.0
        board["circle_rate_dps"] = self.parameters.get("CIRCLE_RATE", 0.0) if circling else 0.0

    # -- messages -------------------------------------------------------------------------------------------------

    def _heartbeat(self, message: Any) -> None:
        self.vehicle["mode"] = float(message.custom_mode)
        armed = float(message.base_mode & ARMED != 0)
        if armed == 0.0:
            self.vehicle["taken_off"] = 0.0
        self.vehicle["armed"] = armed

    def _local_position_ned(self, message: Any) -> None:
        self.vehicle.set(x_est_m=message.x, y_est_m=message.y, climb_est_mps=-message.vz)

    def _global_position_int(self, message: Any) -> None:
        self.vehicle["altitude_est_m"] = message.relative_alt * 1e-3

    def _extended_sys_state(self, message: Any) -> None:
        landed = message.landed_state == ON_GROUND
        if not landed and self.vehicle["armed"] != 0.0:
            self.vehicle["taken_off"] = 1.0
        self.vehicle.set(landed=float(landed), takeoff=float(message.landed_state == TAKING_OFF))

    def _rc_channels(self, message: Any) -> None:
        self.vehicle.set(
            rc1_pwm=message.chan1_raw, rc2_pwm=message.chan2_raw, rc3_pwm=message.chan3_raw, rc4_pwm=message.chan4_raw
        )

    def _nav_controller_output(self, message: Any) -> None:
        self.vehicle["altitude_target_m"] = self.vehicle["altitude_est_m"] + message.alt_error

    def _gps_raw_int(self, message: Any) -> None:
        self.vehicle.set(
            gps_altitude_m=message.alt * 1e-3 - self._home[2],
            gps_satellites=message.satellites_visible,
            gps_ok=float(message.fix_type >= FIX_3D),
        )

    def _sys_status(self, message: Any) -> None:
        health = message.onboard_control_sensors_health
        self._prearm = health & PREARM != 0
        self.ready = self._prearm and self._ekf
        self.vehicle.set(
            baro_ok=float(health & BARO != 0),
            rc_present=float(health & RECEIVER != 0),
            battery_v=message.voltage_battery * 1e-3,
        )

    def _ekf_status_report(self, message: Any) -> None:
        self._ekf = message.flags & EKF_NEEDED == EKF_NEEDED
        self.ready = self._prearm and self._ekf

    def _mission_current(self, message: Any) -> None:
        self.vehicle["mission_item"] = max(0.0, message.seq - 1.0)

    def _home_position(self, message: Any) -> None:
        self._home_xy = to_local(message.latitude * 1e-7, message.longitude * 1e-7, self._home[0], self._home[1])

    def _fence_status(self, message: Any) -> None:
        self.vehicle["failsafe_fence"] = float(message.breach_status != 0)

    def _param_value(self, message: Any) -> None:
        if self.parameters.get(message.param_id) != message.param_value:
            self.parameters[message.param_id] = message.param_value
            self.changes += 1
            settings.show(self.vehicle, self.parameters)

    def _text(self, message: Any, time_s: float) -> None:
        text, severity = str(message.text), int(message.severity)
        kind = "error" if severity <= ERROR_UP_TO else "warning" if severity <= WARNING_UP_TO else "info"
        self.texts.append(TraceMessage(at_s=round(time_s - self.zero_s, 6), text=text, severity=kind))  # type: ignore[arg-type]
        for words, slot in _RAISED.items():
            if text.startswith(words):
                self.vehicle[slot] = 1.0
        for words, slot in _CLEARED.items():
            if text.startswith(words):
                self.vehicle[slot] = 0.0
        if "Battery" in text and "Failsafe" in text:
            self.vehicle["failsafe_battery"] = 1.0
        if text.startswith("Parachute: Released"):
            self.vehicle["chute_released"] = 1.0
