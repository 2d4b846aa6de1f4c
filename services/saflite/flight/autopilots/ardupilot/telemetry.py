"""What the autopilot says over MAVLink, as slots of the trace; its last word on each stays."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from typing import Any

from saflite.contract.signals import MODES as COMMON_MODES
from saflite.flight.autopilots.ardupilot import settings
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.external import telemetry
from saflite.flight.autopilots.external.telemetry import FIX_3D, PREARM, TAKING_OFF
from saflite.flight.mission import to_local

MODES: dict[str, int] = {
    **COMMON_MODES,
    "AUTOTUNE": 15,
    "POSHOLD": 16,
    "THROW": 18,
    "GUIDED_NOGPS": 20,
    "FLOWHOLD": 22,
    "ZIGZAG": 24,
    "TURTLE": 28,
}
RATES_HZ: dict[str, float] = {
    "HEARTBEAT": 25.0,
    "LOCAL_POSITION_NED": 25.0,
    "EXTENDED_SYS_STATE": 25.0,
    "RC_CHANNELS": 25.0,
    "GLOBAL_POSITION_INT": 10.0,
    "NAV_CONTROLLER_OUTPUT": 10.0,
    "GPS_RAW_INT": 5.0,
    "SYS_STATUS": 10.0,
    "EKF_STATUS_REPORT": 5.0,
    "MISSION_CURRENT": 5.0,
    "HOME_POSITION": 1.0,
    "FENCE_STATUS": 25.0,
}
AUTONOMOUS = (MODES["AUTO"], MODES["GUIDED"])
GEOFENCE = 1048576  # MAV_SYS_STATUS_GEOFENCE
_BY_HAND = ("STABILIZE", "ACRO", "ALT_HOLD", "SPORT", "FLIP", "LAND", "AUTOTUNE", "GUIDED_NOGPS", "FLOWHOLD", "TURTLE")
NEED_NO_PLACE = frozenset(float(MODES[name]) for name in _BY_HAND)
LANDS_FROM_ALL = 3.0  # FS_EKF_ACTION
SOUND_REPORTS = 6  # of the filter, 5 a second, until its failsafe is over: a second without a variance above the limit
ORIGIN_STEP_M = 3.0  # the same place, told by two messages a moment apart, differs by less
ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
EKF_NEEDED = 1 | 2 | 4 | 8 | 16 | 32  # EKF_STATUS_FLAGS: attitude, speeds, places, height
_FAILSAFES = {"Radio": "failsafe_radio", "EKF": "failsafe_gps", "Battery": "failsafe_battery"}
_TOLD = re.compile(r"([A-Z]\w+(?: \+ [A-Z]\w+)*) Failsafe\b(.*)")  # two at once are joined by a plus


class Telemetry(telemetry.Telemetry):
    """Takes the vehicle's messages; `parameters` are all that are known, kept up to date."""

    def __init__(
        self,
        vehicle: Vehicle,
        parameters: Mapping[str, float],
        home: tuple[float, float, float],
        kinds: Collection[str] = tuple(RATES_HZ),
    ) -> None:
        super().__init__(vehicle, parameters, home, kinds, settings.show)
        self._prearm = self._ekf = self._taking_off = False
        self._local_xy, self._origin_xy, self._jumped = (0.0, 0.0), (0.0, 0.0), False
        self.tells_ekf, self._sound_reports = True, 0  # whether this build tells of the filter's failsafe
        self._fenced: bool | None = None  # the parameter does not tell: DO_FENCE_ENABLE leaves it as it is

    def tick(self) -> None:
        """Work out what follows from the truth of this tick."""
        super().tick()
        board = self.vehicle
        ordered = board["mode"] in AUTONOMOUS  # the pilot's own take-offs have no height to reach
        board["takeoff"] = float(ordered and self._taking_off)
        circling = board["mode"] == MODES["CIRCLE"]
        board["circle_radius_m"] = board["circle_radius_set_m"] if circling else 0.0
        fenced = self.parameters.get("FENCE_ENABLE", 0.0) != 0.0 if self._fenced is None else self._fenced
        board["fence_on_set"] = float(fenced)
        board["fence_enabled"] = float(fenced and int(self.parameters.get("FENCE_TYPE", 0.0)) & settings.CEILING != 0)
        board["circle_rate_dps"] = self.parameters.get("CIRCLE_RATE", 0.0) if circling else 0.0

    # -- messages -------------------------------------------------------------------------------------------------

    def _heartbeat(self, message: Any) -> None:
        self.vehicle["mode"] = float(message.custom_mode)
        armed = float(message.base_mode & ARMED != 0)
        if armed == 0.0:
            self.vehicle["taken_off"] = 0.0
        self.vehicle["armed"] = armed

    def _local_position_ned(self, message: Any) -> None:
        local_xy = message.x, message.y
        self._jumped = self._jumped or math.dist(local_xy, self._local_xy) > ORIGIN_STEP_M
        self._local_xy = local_xy
        x_m, y_m = message.x + self._origin_xy[0], message.y + self._origin_xy[1]
        if self._jumped:  # the vehicle, or what is counted from? The next global place tells
            x_m, y_m = self.vehicle["x_est_m"], self.vehicle["y_est_m"]
        self.vehicle.set(x_est_m=x_m, y_est_m=y_m, climb_est_mps=-message.vz)

    def _global_position_int(self, message: Any) -> None:
        """See from where local places count: older builds count from home, which moves as the vehicle is armed."""
        super()._global_position_int(message)
        place = to_local(message.lat * 1e-7, message.lon * 1e-7, self._home[0], self._home[1])
        origin_xy = place[0] - self._local_xy[0], place[1] - self._local_xy[1]
        if message.lat and math.dist(origin_xy, self._origin_xy) > ORIGIN_STEP_M:
            self._origin_xy = origin_xy
        self._jumped = False

    def _extended_sys_state(self, message: Any) -> None:
        super()._extended_sys_state(message)
        self._taking_off = message.landed_state == TAKING_OFF

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
        self._prearm = message.onboard_control_sensors_health & PREARM != 0
        self.ready = self._prearm and self._ekf
        reports_only = self.parameters.get("FENCE_ACTION", 1.0) == 0.0  # told as off then, on or not
        self._fenced = None if reports_only else message.onboard_control_sensors_enabled & GEOFENCE != 0
        self._show_health(message)

    def _ekf_status_report(self, message: Any) -> None:
        self._ekf = message.flags & EKF_NEEDED == EKF_NEEDED
        self.ready = self._prearm and self._ekf
        if not self.tells_ekf and self.vehicle["failsafe_gps"] != 0.0:
            limit = self.parameters.get("FS_EKF_THRESH", 0.8)
            greatest = max(message.velocity_variance, message.pos_horiz_variance, message.compass_variance)
            self._sound_reports = self._sound_reports + 1 if self._ekf and greatest < limit else 0
            if self._sound_reports >= SOUND_REPORTS or self.vehicle["armed"] == 0.0:
                self.vehicle["failsafe_gps"] = 0.0

    def _mission_current(self, message: Any) -> None:
        self.vehicle["mission_item"] = max(0.0, message.seq - 1.0)

    def _fence_status(self, message: Any) -> None:
        self.vehicle["failsafe_fence"] = float(message.breach_status != 0)

    def _statustext(self, message: Any) -> None:
        super()._statustext(message)
        text = self.texts[-1].text
        told = _TOLD.match(text)
        for name in told[1].split(" + ") if told else ():
            if name in _FAILSAFES:
                self.vehicle[_FAILSAFES[name]] = float(told is not None and "Cleared" not in told[2])
        if not self.tells_ekf and text.startswith("EKF variance") and self._acts_on_lost_place():
            self.vehicle["failsafe_gps"], self._sound_reports = 1.0, 0
        if text.startswith("Parachute: Released"):
            self.vehicle["chute_released"] = 1.0

    def _acts_on_lost_place(self) -> bool:
        lands = self.parameters.get("FS_EKF_ACTION", 0.0) == LANDS_FROM_ALL
        return self.vehicle["armed"] != 0.0 and (lands or self.vehicle["mode"] not in NEED_NO_PLACE)
