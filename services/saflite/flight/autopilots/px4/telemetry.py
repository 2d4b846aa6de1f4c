"""What PX4 says over MAVLink, as slots of the trace; its last word on each stays."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

from saflite.contract.test_case import Stimulus
from saflite.flight.autopilots.external import telemetry
from saflite.flight.autopilots.external.telemetry import FIX_3D, PREARM
from saflite.flight.autopilots.px4 import modes, settings
from saflite.flight.autopilots.px4.places import HEIGHT_AT
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client

TOLD = "HEARTBEAT"
"""Told once a second, whatever is asked for; its mode and its armed bit come sooner by other ways."""
RATES_HZ: dict[str, float] = {
    "LOCAL_POSITION_NED": 25.0,
    "EXTENDED_SYS_STATE": 25.0,
    "POSITION_TARGET_LOCAL_NED": 10.0,
    "GLOBAL_POSITION_INT": 10.0,
    "RC_CHANNELS": 10.0,
    "GPS_RAW_INT": 10.0,
    "SYS_STATUS": 5.0,
    "HIGH_LATENCY2": 25.0,
    "MISSION_CURRENT": 5.0,
    "HOME_POSITION": 1.0,
}
FAILSAFE = 5  # MAV_STATE_CRITICAL
GPS, RADIO, BATTERY, FENCE = 1, 256, 128, 2048  # HL_FAILURE_FLAG bits
NOT_KNOWN = 65535
FRESH_S = 2.0  # a receiver that has said nothing for longer is silent
FLAG_S = 1.0  # a cause of failure is told again only when PX4 has looked again, twice a second at least


class Telemetry(telemetry.Telemetry):
    """Takes the vehicle's messages; `parameters` are all that are known, kept up to date."""

    def __init__(
        self,
        vehicle: Vehicle,
        client: Client,
        parameters: Mapping[str, float],
        home: tuple[float, float, float],
        kinds: Collection[str] = tuple(RATES_HZ),
    ) -> None:
        super().__init__(vehicle, parameters, home, (TOLD, *kinds), settings.show)
        self._client = client
        self._prearm = self._homed = self._failsafe = False
        self._takeoff_up_m: float | None = None  # of the take-off ordered last; PX4 does not tell it
        self._flag_said_s = dict.fromkeys((GPS, RADIO, BATTERY, FENCE), -math.inf)
        self._gps_said_s = -math.inf

    def take_order(self, stimulus: Stimulus) -> None:
        """Note the height of a take-off that was taken: it is above a home that PX4 may have corrected since."""
        values = stimulus.values
        if stimulus.kind == "command" and stimulus.name.endswith("NAV_TAKEOFF") and len(values) > HEIGHT_AT:
            self._takeoff_up_m = self._home[2] + values[HEIGHT_AT] - self._start_up_m

    def tick(self) -> None:
        """Work out what follows from the truth of this tick."""
        super().tick()
        if self._takeoff_up_m is not None:
            self.vehicle["takeoff_altitude_set_m"] = self._takeoff_up_m
        if self._now_s - self._gps_said_s > FRESH_S:
            self.vehicle["gps_ok"] = 0.0
        if (
            self.vehicle["armed"] == 0.0
        ):  # the armed bit comes with the motor commands (`native/packets.c`, `own_truth.py`)
            self.vehicle["taken_off"] = 0.0
        self.ready = self._prearm and self._homed

    # -- messages -------------------------------------------------------------------------------------------------

    def _heartbeat(self, message: Any) -> None:
        self._failsafe = message.system_status == FAILSAFE
        self._show_mode(message.custom_mode)
        self._show_failsafes()

    def _high_latency2(self, message: Any) -> None:
        self._show_mode(message.custom_mode << 16)
        for flag in self._flag_said_s:
            if message.failure_flags & flag:
                self._flag_said_s[flag] = self._now_s
        self._show_failsafes()

    def _show_mode(self, custom_mode: int) -> None:
        taking_off = modes.pair(custom_mode) == (modes.AUTO, modes.TAKEOFF)
        self.vehicle.set(mode=modes.shown(custom_mode), takeoff=float(taking_off))

    def _show_failsafes(self) -> None:
        """A failsafe counts by its causes: what has failed while one is in force."""
        now = {flag: self._now_s - said_s <= FLAG_S for flag, said_s in self._flag_said_s.items()}
        self.vehicle.set(
            failsafe_gps=float(self._failsafe and now[GPS]),
            failsafe_radio=float(self._failsafe and now[RADIO]),
            failsafe_battery=float(self._failsafe and now[BATTERY]),
            failsafe_fence=float(now[FENCE]),
        )

    def _position_target_local_ned(self, message: Any) -> None:
        aim_m = -message.z
        self.vehicle["altitude_target_m"] = aim_m if math.isfinite(aim_m) else self.vehicle["altitude_est_m"]

    def _rc_channels(self, message: Any) -> None:
        pulses = (message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw)
        if NOT_KNOWN not in pulses:
            self.vehicle.set(**{f"rc{number}_pwm": pulse for number, pulse in enumerate(pulses, 1)})

    def _gps_raw_int(self, message: Any) -> None:
        self._gps_said_s = self._now_s
        fixed = float(message.fix_type >= FIX_3D)
        self.vehicle.set(gps_altitude_m=message.alt * 1e-3 - self._home[2], gps_ok=fixed)

    def _sys_status(self, message: Any) -> None:
        self._prearm = message.onboard_control_sensors_health & PREARM != 0
        self._show_health(message)

    def _mission_current(self, message: Any) -> None:
        self.vehicle["mission_item"] = float(message.seq)

    def _home_position(self, message: Any) -> None:
        self._homed = True
        super()._home_position(message)

    def _value_of(self, message: Any) -> float:
        return self._client.decoded(message.param_value, message.param_type)
