"""What a vehicle tells over MAVLink: telemetry at ArduCopter's usual rates, in MAVLink's units."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from saflite.flight.mavlink.vehicle import LinkedVehicle, Status
from saflite.flight.mission import to_geographic

STANDBY, ACTIVE = 3, 4
CUSTOM_MODE, ARMED, STABILIZED = 1, 128, 16 | 64
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x4000 | 0x8000 | 0x10000 | 0x200000
SENSOR_GPS, SENSOR_BARO, SENSOR_RADIO = 0x20, 0x8, 0x10000
ON_GROUND, IN_AIR = 1, 2
GEOFENCE = 0x100000
UNKNOWN_U16 = 65535
CHANNELS_MAX = 18
AUTOPILOT_VERSION, HOME_POSITION = 148, 242
# missions, parameters, command int, set-points, MAVLink 2, fence and rally points as missions
CAPABILITIES = 0x1 | 0x2 | 0x4 | 0x8 | 0x80 | 0x100 | 0x2000 | 0x4000 | 0x8000
GROUPS: dict[int, tuple[int, ...]] = {2: (1, 42, 24), 3: (36, 65), 6: (33, 32), 10: (30,), 11: (74,), 12: (2, 193)}
"""Messages by stream (MAV_DATA_STREAM: status, channels, position, extra 1 to 3), as ArduCopter groups them."""
TICK_US, INTERVAL_MAX_US = 20_000, 60_000_000  # ArduPilot's longest interval


class Streams:
    """Sends telemetry through `link`, a pymavlink `MAVLink`."""

    def __init__(self, vehicle: LinkedVehicle, link: Any) -> None:
        self._vehicle, self._link = vehicle, link
        self._said, self._item = 0, 0
        # number of the message: ticks from one to the next by default (0: only when asked for), what sends it
        self._plan: dict[int, tuple[int, Callable[[Status], None]]] = {
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
        self._tell_reached()
        texts = self._vehicle.texts
        for message in texts[self._said :]:
            severity = {"error": 3, "warning": 4}.get(message.severity, 6)
            self._link.statustext_send(severity, message.text.encode()[:50])
        self._said = len(texts)

    def _tell_reached(self) -> None:
        """Say that an item was reached once the vehicle goes on to the next one."""
        item = self._vehicle.mission_index
        if self._vehicle.mission and item == self._item + 1:
            self._link.mission_item_reached_send(item)  # counted from 1: item 0 is home
        self._item = item

    def set_stream(self, group: int, rate_hz: float, on: bool) -> None:
        """Send the messages of a stream (0: of all) at a rate, or not at all (REQUEST_DATA_STREAM)."""
        numbers = GROUPS.get(group, ()) if group else tuple(number for row in GROUPS.values() for number in row)
        for number in numbers:
            self.set_interval(number, 1e6 / rate_hz if on and rate_hz > 0 else -1.0)

    def __contains__(self, number: float) -> bool:
        return number in self._plan

    def send(self, number: int) -> None:
        """Send a message now."""
        self._plan[number][1](self._vehicle.status())

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

    def _geographic(self, north_m: float, east_m: float) -> tuple[int, int]:
        """Return latitude and longitude in degrees x 1e7."""
        lat, lon = to_geographic(north_m, east_m, *self._vehicle.origin[:2])
        return round(lat * 1e7), round(lon * 1e7)

    def _above_sea_m(self, up_m: float) -> float:
        return self._vehicle.origin.altitude_m + up_m

    def _heartbeat(self, now: Status) -> None:
        base = CUSTOM_MODE | STABILIZED | (ARMED if now.armed else 0)
        state = STANDBY if now.landed else ACTIVE
        kind = self._vehicle.kind
        self._link.heartbeat_send(kind.vehicle, kind.autopilot, base, now.mode, state)

    def _version(self, now: Status) -> None:
        version = self._vehicle.kind.version
        self._link.autopilot_version_send(CAPABILITIES, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1)

    def _home(self, now: Status) -> None:
        north, east, up = now.home_m
        altitude = round(self._above_sea_m(up) * 1e3)
        place = self._geographic(north, east)
        self._link.home_position_send(*place, altitude, north, east, -up, [1, 0, 0, 0], 0, 0, 0)

    def _status(self, now: Status) -> None:
        healthy, enabled = SENSORS, SENSORS | (GEOFENCE if now.fence_on else 0)
        for bit, good in ((SENSOR_GPS, now.gps_ok), (SENSOR_BARO, now.baro_ok), (SENSOR_RADIO, now.radio_ok)):
            healthy &= SENSORS if good else ~bit
        healthy |= 0 if now.fence_breached else GEOFENCE
        left = max(0, round(100.0 * now.battery_left))
        volts, amps = round(now.battery_v * 1e3), round(now.battery_a * 100)
        self._link.sys_status_send(SENSORS | GEOFENCE, enabled, healthy, 300, volts, amps, left, 0, 0, 0, 0, 0, 0)

    def _estimator(self, now: Status) -> None:
        flags = 0x1 | 0x2 | 0x4 | 0x20 | (0x8 | 0x10 | 0x200 if now.position_ok else 0x80)
        self._link.ekf_status_report_send(flags, 0.1, min(1.0, now.innovation_ratio), 0.1, 0.1, 0.0)

    def _mission_item(self, now: Status) -> None:
        self._link.mission_current_send(self._vehicle.mission_index + 1 if self._vehicle.mission else 0)

    def _landed(self, now: Status) -> None:
        self._link.extended_sys_state_send(0, ON_GROUND if now.landed else IN_AIR)

    def _system_time(self, now: Status) -> None:
        self._link.system_time_send(0, _milliseconds(now))

    def _attitude(self, now: Status) -> None:
        self._link.attitude_send(_milliseconds(now), *now.attitude_rad, *now.rates_rps)

    def _global_position(self, now: Status) -> None:
        north, east, down = now.position_m
        place = self._geographic(north, east)
        above_sea, above_home = round(self._above_sea_m(-down) * 1e3), round(now.altitude_m * 1e3)
        speeds = (round(speed * 100) for speed in now.speed_mps)
        heading = round(_heading_deg(now) * 100) % 36000
        self._link.global_position_int_send(_milliseconds(now), *place, above_sea, above_home, *speeds, heading)

    def _local_position(self, now: Status) -> None:
        self._link.local_position_ned_send(_milliseconds(now), *now.position_m, *now.speed_mps)

    def _hud(self, now: Status) -> None:
        speed = math.hypot(*now.speed_mps[:2])
        heading, throttle = round(_heading_deg(now)) % 360, round(100 * now.throttle)
        above_sea = self._above_sea_m(-now.position_m[2])
        self._link.vfr_hud_send(speed, speed, heading, throttle, above_sea, -now.speed_mps[2])

    def _gps(self, now: Status) -> None:
        north, east, up = now.gps_position_m
        fix = 3 if now.gps_ok else 1
        self._link.gps_raw_int_send(
            _milliseconds(now) * 1000,
            fix,
            *self._geographic(north, east),
            round(self._above_sea_m(up) * 1e3),
            120 if fix == 3 else UNKNOWN_U16,
            UNKNOWN_U16,
            round(math.hypot(*now.gps_speed_mps) * 100),
            UNKNOWN_U16,
            now.gps_satellites,
        )

    def _radio(self, now: Status) -> None:
        received = [round(now.sticks_pwm.get(channel, 0)) for channel in range(1, CHANNELS_MAX + 1)]
        self._link.rc_channels_send(_milliseconds(now), 8, *received, 254 if now.radio_present else 0)

    def _motors(self, now: Status) -> None:
        motors = [round(1000 + 1000 * share) for share in now.motors]
        self._link.servo_output_raw_send(_milliseconds(now) * 1000 % 2**32, 0, *motors, 0, 0, 0, 0)


def _milliseconds(now: Status) -> int:
    return max(0, round(now.time_s * 1000.0))


def _heading_deg(now: Status) -> float:
    return math.degrees(now.attitude_rad[2]) % 360.0
