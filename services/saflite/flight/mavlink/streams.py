"""What the reference vehicle tells over MAVLink: telemetry at ArduCopter's usual rates, in its units."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from saflite.contract.signals import MODES
from saflite.flight.autopilots.reference.autopilot import Autopilot
from saflite.flight.mission import to_geographic
from saflite.flight.world.jsbsim_world import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG

QUADROTOR, ARDUPILOT, STANDBY, ACTIVE = 2, 3, 3, 4
CUSTOM_MODE, ARMED, STABILIZED = 1, 128, 16 | 64
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x4000 | 0x8000 | 0x10000 | 0x200000
SENSOR_GPS, SENSOR_BARO, SENSOR_RADIO = 0x20, 0x8, 0x10000
ON_GROUND, IN_AIR = 1, 2
UNKNOWN_U16 = 65535
CHANNELS_MAX = 18
AUTOPILOT_VERSION, HOME_POSITION = 148, 242
CAPABILITIES = 0x1 | 0x2 | 0x4 | 0x8 | 0x80 | 0x100 | 0x2000  # missions, parameters, command int, set-points, MAVLink 2
VERSION = (4 << 24) | (0 << 16) | (0 << 8) | 255
TICK_US, INTERVAL_MAX_US = 20_000, 60_000_000  # ArduPilot's longest interval


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
        # number of the message: ticks from one to the next by default (0: only when asked for), what sends it
        self._plan: dict[int, tuple[int, Callable[[], None]]] = {
            0: (50, self._heartbeat),
            1: (50, self._status),
            193: (50, self._estimator),
            42: (50, self._mission_item),
            245: (50, self._landed),
            2: (50, self._system_time),
            30: (5, self._attitude),
            33: (10, self._global_position),
            32: (10, self._local_position),
            74: (10, self._hud),
            24: (25, self._gps),
            65: (25, self._radio),
            36: (25, self._motors),
            HOME_POSITION: (0, self._home),
            AUTOPILOT_VERSION: (0, self._version),
        }
        self._every = {number: every for number, (every, _) in self._plan.items()}

    def tick(self, ticks: int) -> None:
        """Send what is due at this tick of 20 ms, and the texts said since."""
        for number, every in self._every.items():
            if every and ticks % every == 0:
                self.send(number)
        for message in self._ap.messages[self._said :]:
            severity = {"error": 3, "warning": 4}.get(message.severity, 6)
            self._link.statustext_send(severity, message.text.encode()[:50])
        self._said = len(self._ap.messages)

    def __contains__(self, number: float) -> bool:
        return number in self._plan

    def send(self, number: int) -> None:
        """Send a message now."""
        self._plan[number][1]()

    def set_interval(self, number: int, interval_us: float) -> bool:
        """Send a message at an interval, rounded to ticks: 0 the default, -1 never. Return whether there is such."""
        if interval_us == 0.0:
            self._every[number] = self._plan[number][0]
        elif interval_us == -1.0:
            self._every[number] = 0
        elif 0.0 < interval_us < math.inf:
            self._every[number] = max(1, round(min(interval_us, INTERVAL_MAX_US) / TICK_US))
        else:
            return False
        return True

    def interval_us(self, number: int) -> int:
        """Return the interval of a message, -1 for one that is sent only when asked for."""
        return self._every[number] * TICK_US or -1

    def _heartbeat(self) -> None:
        base = CUSTOM_MODE | STABILIZED | (ARMED if self._ap.armed else 0)
        state = STANDBY if self._ap.landed else ACTIVE
        self._link.heartbeat_send(QUADROTOR, ARDUPILOT, base, MODES[self._ap.mode.name], state)

    def _version(self) -> None:
        self._link.autopilot_version_send(CAPABILITIES, VERSION, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1)

    def _home(self) -> None:
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

    def _estimator(self) -> None:
        board = self._ap.board
        flags = 0x1 | 0x2 | 0x4 | 0x20 | (0x8 | 0x10 | 0x200 if board["position_ok"] != 0.0 else 0x80)
        ratio = min(1.0, board["innovation_ratio"])
        self._link.ekf_status_report_send(flags, 0.1, ratio, 0.1, 0.1, 0.0)

    def _mission_item(self) -> None:
        self._link.mission_current_send(self._ap.mission_index + 1 if self._ap.mission else 0)

    def _landed(self) -> None:
        self._link.extended_sys_state_send(0, ON_GROUND if self._ap.landed else IN_AIR)

    def _system_time(self) -> None:
        self._link.system_time_send(0, self._milliseconds())

    def _attitude(self) -> None:
        board = self._ap.board
        angles = (board["est_roll"], board["est_pitch"], board["est_yaw"])
        self._link.attitude_send(self._milliseconds(), *angles, board["est_p"], board["est_q"], board["est_r"])

    def _global_position(self) -> None:
        board = self._ap.board
        lat, lon, above_sea, above_home = place(self._ap)
        speeds = (round(board[name] * 100) for name in ("est_vn", "est_ve", "est_vd"))
        heading = round(heading_deg(self._ap) * 100) % 36000
        self._link.global_position_int_send(self._milliseconds(), lat, lon, above_sea, above_home, *speeds, heading)

    def _local_position(self) -> None:
        names = ("est_n", "est_e", "est_d", "est_vn", "est_ve", "est_vd")
        self._link.local_position_ned_send(self._milliseconds(), *(self._ap.board[name] for name in names))

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

    def _motors(self) -> None:
        motors = [round(1000 + 1000 * self._ap.board[f"motor_{i}"]) for i in range(1, 5)]
        self._link.servo_output_raw_send(self._milliseconds() * 1000 % 2**32, 0, *motors, 0, 0, 0, 0)

    def _milliseconds(self) -> int:
        return max(0, round(self._ap.time_s * 1000.0))
