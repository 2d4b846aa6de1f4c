"""What the reference vehicle tells over MAVLink: telemetry at ArduCopter's usual rates, in its units."""

from __future__ import annotations

import math
from typing import Any

from saflite.contract.signals import MODES
from saflite.flight.autopilots.reference.autopilot import Autopilot
from saflite.flight.jsbsim_world import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG
from saflite.flight.mission import to_geographic

QUADROTOR, ARDUPILOT, STANDBY, ACTIVE = 2, 3, 3, 4
CUSTOM_MODE, ARMED, STABILIZED = 1, 128, 16 | 64
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x4000 | 0x8000 | 0x10000 | 0x200000
SENSOR_GPS, SENSOR_BARO, SENSOR_RADIO = 0x20, 0x8, 0x10000
ON_GROUND, IN_AIR = 1, 2
UNKNOWN_U16 = 65535
CHANNELS_MAX = 18


def place(ap: Autopilot) -> tuple[int, int, int, int]:
    """Return latitude, longitude (degrees x 1e7), height above sea and above home (mm), as estimated."""
    board = ap.board
    lat, lon = to_geographic(board["est_n"], board["est_e"], HOME_LAT_DEG, HOME_LON_DEG)
    return (
        round(lat * 1e7),
        round(lon * 1e7),
        round((HOME_ALT_M - board["est_d"]) * 1e3),
        round(board["altitude_est_m"] * 1e3),
    )


def heading_deg(ap: Autopilot) -> float:
    """Return the estimated heading, 0..360."""
    return math.degrees(ap.board["est_yaw"]) % 360.0


class Streams:
    """Sends telemetry through `link`, a pymavlink `MAVLink`."""

    def __init__(self, ap: Autopilot, link: Any) -> None:
        self._ap, self._link = ap, link
        self._said = 0
        self._plan = (
            (50, self.heartbeat),
            (50, self._status),
            (50, self._slow),
            (5, self._attitude),
            (10, self._position),
            (10, self._hud),
            (25, self._gps),
            (25, self._radio),
        )

    def tick(self, ticks: int) -> None:
        """Send what is due at this tick of 20 ms, and the texts said since."""
        for every, send in self._plan:
            if ticks % every == 0:
                send()
        for message in self._ap.messages[self._said :]:
            severity = {"error": 3, "warning": 4}.get(message.severity, 6)
            self._link.statustext_send(severity, message.text.encode()[:50])
        self._said = len(self._ap.messages)

    def heartbeat(self) -> None:
        """Type, mode and whether it is armed."""
        base = CUSTOM_MODE | STABILIZED | (ARMED if self._ap.armed else 0)
        state = STANDBY if self._ap.landed else ACTIVE
        self._link.heartbeat_send(QUADROTOR, ARDUPILOT, base, MODES[self._ap.mode.name], state)

    def home(self) -> None:
        """Where home is."""
        north, east, up = self._ap.home
        lat, lon = to_geographic(north, east, HOME_LAT_DEG, HOME_LON_DEG)
        altitude = round((HOME_ALT_M + up) * 1e3)
        self._link.home_position_send(
            round(lat * 1e7), round(lon * 1e7), altitude, north, east, -up, [1, 0, 0, 0], 0, 0, 0
        )

    def _status(self) -> None:
        board = self._ap.board
        healthy = SENSORS
        for bit, good in (
            (SENSOR_GPS, board["gps_ok"] != 0.0),
            (SENSOR_BARO, board["baro_ok"] != 0.0),
            (SENSOR_RADIO, not self._ap.failsafes.radio),
        ):
            healthy &= SENSORS if good else ~bit
        amps, left = board["battery_a"], 100.0 * (1.0 - board["battery_used_mah"] / 5200.0)
        volts = round(board["battery_v"] * 1e3)
        self._link.sys_status_send(
            SENSORS, SENSORS, healthy, 300, volts, round(amps * 100), max(0, round(left)), 0, 0, 0, 0, 0, 0
        )

    def _slow(self) -> None:
        board = self._ap.board
        flags = 0x1 | 0x2 | 0x4 | 0x20 | (0x8 | 0x10 | 0x200 if board["position_ok"] != 0.0 else 0x80)
        ratio = min(1.0, board["innovation_ratio"])
        self._link.ekf_status_report_send(flags, 0.1, ratio, 0.1, 0.1, 0.0)
        self._link.mission_current_send(self._ap.mission_index + 1 if self._ap.mission else 0)
        self._link.extended_sys_state_send(0, ON_GROUND if self._ap.landed else IN_AIR)
        self._link.system_time_send(0, self._milliseconds())

    def _attitude(self) -> None:
        board = self._ap.board
        angles = (board["est_roll"], board["est_pitch"], board["est_yaw"])
        self._link.attitude_send(self._milliseconds(), *angles, board["est_p"], board["est_q"], board["est_r"])

    def _position(self) -> None:
        board = self._ap.board
        lat, lon, above_sea, above_home = place(self._ap)
        speeds = (round(board[name] * 100) for name in ("est_vn", "est_ve", "est_vd"))
        now = self._milliseconds()
        self._link.global_position_int_send(
            now, lat, lon, above_sea, above_home, *speeds, round(heading_deg(self._ap) * 100) % 36000
        )
        names = ("est_n", "est_e", "est_d", "est_vn", "est_ve", "est_vd")
        self._link.local_position_ned_send(now, *(board[name] for name in names))

    def _hud(self) -> None:
        board = self._ap.board
        speed = math.hypot(board["est_vn"], board["est_ve"])
        throttle = round(100 * board["throttle"])
        above_sea = HOME_ALT_M - board["est_d"]
        self._link.vfr_hud_send(
            speed, speed, round(heading_deg(self._ap)) % 360, throttle, above_sea, board["climb_est_mps"]
        )

    def _gps(self) -> None:
        board = self._ap.board
        lat, lon = to_geographic(board["gps_north"], board["gps_east"], HOME_LAT_DEG, HOME_LON_DEG)
        speed = math.hypot(board["gps_vn"], board["gps_ve"])
        fix = 3 if board["gps_ok"] != 0.0 else 1
        self._link.gps_raw_int_send(
            self._milliseconds() * 1000,
            fix,
            round(lat * 1e7),
            round(lon * 1e7),
            round((HOME_ALT_M + board["gps_up"]) * 1e3),
            120 if fix == 3 else UNKNOWN_U16,
            UNKNOWN_U16,
            round(speed * 100),
            UNKNOWN_U16,
            round(board["gps_satellites"]),
        )

    def _radio(self) -> None:
        received = [round(self._ap.radio.received.get(i, 0)) for i in range(1, CHANNELS_MAX + 1)]
        self._link.rc_channels_send(self._milliseconds(), 8, *received, 254 if self._ap.radio.present else 0)
        motors = [round(1000 + 1000 * self._ap.board[f"motor_{i}"]) for i in range(1, 5)]
        self._link.servo_output_raw_send(self._milliseconds() * 1000 % 2**32, 0, *motors, 0, 0, 0, 0)

    def _milliseconds(self) -> int:
        return max(0, round(self._ap.time_s * 1000.0))
