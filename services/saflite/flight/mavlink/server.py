"""The server side of a MAVLink link: bytes in, bytes out, no socket, no autopilot. Parameters, commands, modes,
missions, sticks, set-points and streams of a vehicle, as a ground station expects of ArduPilot."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import Any

from saflite.flight.mavlink.mission_transfer import MissionTransfer
from saflite.flight.mavlink.streams import AUTOPILOT_VERSION, CUSTOM_MODE, HOME_POSITION, Streams
from saflite.flight.mavlink.vehicle import LinkedVehicle
from saflite.flight.mission import to_local

log = logging.getLogger(__name__)

REAL32 = 9  # the other MAV_PARAM_TYPEs in use are whole numbers
ACCEPTED, DENIED, FAILED = 0, 2, 4  # MAV_RESULT
SET_MODE, REBOOT = 11, 246  # number of the message, MAV_CMD
GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 510, 511, 512
REQUEST_CAPABILITIES, GET_HOME = 520, 410
RELEASE, IGNORE = 0, 65535
POSITION_IGNORED, SPEED_IGNORED = 0b111, 0b111000
PARAMETERS_PER_TICK = 20
LOCAL_FRAMES, BODY_FRAMES = {1, 7}, {8, 9}


class MavlinkServer:
    """One vehicle on a link.

    Args:
        vehicle: what flies.
        system: its number on the link.
    """

    def __init__(self, vehicle: LinkedVehicle, system: int = 1) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self._vehicle = vehicle
        self._system = system
        self._out = bytearray()
        self._link: Any = ardupilotmega.MAVLink(self, srcSystem=system, srcComponent=1)
        self._link.robust_parsing = True
        self._reader: Any = ardupilotmega.MAVLink(None)
        self._reader.robust_parsing = True
        self._streams = Streams(vehicle, self._link)
        self._mission = MissionTransfer(vehicle, self._link)
        self._names = sorted(vehicle.parameters)
        self._queue: list[int] = []
        self._reported: set[tuple[str, type[Exception]]] = set()

    def write(self, data: bytes) -> None:
        """Take bytes that pymavlink packed."""
        self._out += data

    def take(self) -> bytes:
        """Return and forget the bytes to send."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def feed(self, data: bytes) -> None:
        """Take received bytes; garbage between messages and messages to other systems are skipped.

        A message that cannot be handled is logged, the first time of its kind, and the link goes on.
        """
        for message in self._reader.parse_buffer(data) or ():
            kind = message.get_type()
            if kind == "BAD_DATA" or not self._is_for_us(message):
                continue
            try:
                self._handle(kind, message)
            except Exception as fault:
                if (kind, type(fault)) not in self._reported:
                    self._reported.add((kind, type(fault)))
                    log.warning("MAVLink message %s cannot be handled: %s", kind, fault, exc_info=True)

    def _is_for_us(self, message: Any) -> bool:
        """Return whether a message names this system, all systems (0) or none.

        The component does not matter: the vehicle has only one, and ArduPilot too takes what names its system and a
        component it has never heard of.
        """
        return getattr(message, "target_system", getattr(message, "target", 0)) in (0, self._system)

    def _handle(self, kind: str, message: Any) -> None:
        if not self._mission.handle(kind, message):
            handler = getattr(self, f"_{kind.lower()}", None)
            if handler is not None:
                handler(message)

    def tick(self, ticks: int) -> None:
        """Send streams and the next piece of a parameter list."""
        self._mission.tick()
        self._streams.tick(ticks)
        for index in self._queue[:PARAMETERS_PER_TICK]:
            self._send_parameter(index)
        del self._queue[:PARAMETERS_PER_TICK]

    # -- parameters -----------------------------------------------------------------------------------------------

    def _param_request_list(self, message: Any) -> None:
        self._queue = list(range(len(self._names)))

    def _param_request_read(self, message: Any) -> None:
        if message.param_index >= 0:
            if message.param_index < len(self._names):
                self._send_parameter(message.param_index)
        elif _text(message.param_id) in self._vehicle.parameters:
            self._send_parameter(self._names.index(_text(message.param_id)))

    def _param_set(self, message: Any) -> None:
        name = _text(message.param_id)
        value = float(message.param_value)
        if name in self._vehicle.parameters and self._vehicle.parameter_type(name) != REAL32 and math.isfinite(value):
            value = float(round(value))
        why = self._vehicle.set_parameter(name, value)
        if why:
            self._vehicle.say(why, "warning")
        if name in self._vehicle.parameters:
            self._send_parameter(self._names.index(name))

    def _send_parameter(self, index: int) -> None:
        name = self._names[index]
        value = self._vehicle.parameters[name]
        self._link.param_value_send(name.encode(), value, self._vehicle.parameter_type(name), len(self._names), index)

    # -- commands and modes ---------------------------------------------------------------------------------------

    def _command_long(self, message: Any) -> None:
        numbers = [getattr(message, f"param{i}") for i in range(1, 8)]
        self._carry_out(message, numbers)

    def _command_int(self, message: Any) -> None:
        numbers = [message.param1, message.param2, message.param3, message.param4]
        self._carry_out(message, [*numbers, message.x / 1e7, message.y / 1e7, message.z])

    def _carry_out(self, message: Any, numbers: Sequence[float]) -> None:
        result = self._own(message.command, numbers)
        if result is None:
            result = self._vehicle.execute(message.command, numbers)
        peer = (message.get_srcSystem(), message.get_srcComponent())
        self._link.command_ack_send(message.command, result, 0, 0, *peer)

    def _own(self, command: int, numbers: Sequence[float]) -> int | None:
        """Commands of the link itself: what to send, reboot."""
        if command in (REQUEST_CAPABILITIES, GET_HOME):
            self._streams.send(AUTOPILOT_VERSION if command == REQUEST_CAPABILITIES else HOME_POSITION)
            return ACCEPTED
        if command in (GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE):
            return self._about_message(command, numbers)
        if command == REBOOT and numbers[0] == 1.0 and self._vehicle.restart():
            return ACCEPTED
        return None

    def _about_message(self, command: int, numbers: Sequence[float]) -> int:
        """Send a message once, set or tell its interval (2nd number, us); the 1st number names the message."""
        if numbers[0] not in self._streams:
            return FAILED
        number = int(numbers[0])
        if command == SET_MESSAGE_INTERVAL:
            return ACCEPTED if self._streams.set_interval(number, numbers[1]) else DENIED
        if command == GET_MESSAGE_INTERVAL:
            self._link.message_interval_send(number, self._streams.interval_us(number))
        else:
            self._streams.send(number)
        return ACCEPTED

    def _request_data_stream(self, message: Any) -> None:
        self._streams.set_stream(message.req_stream_id, message.req_message_rate, message.start_stop == 1)

    def _set_mode(self, message: Any) -> None:
        custom = message.base_mode & CUSTOM_MODE
        why = self._vehicle.set_mode(message.custom_mode) if custom else "only custom modes"
        peer = (message.get_srcSystem(), message.get_srcComponent())
        self._link.command_ack_send(SET_MODE, FAILED if why else ACCEPTED, 0, 0, *peer)

    # -- sticks and set-points ------------------------------------------------------------------------------------

    def _rc_channels_override(self, message: Any) -> None:
        for channel in range(1, 9):
            pulse = getattr(message, f"chan{channel}_raw")
            if pulse not in (RELEASE, IGNORE):
                self._vehicle.stick(channel, float(pulse))

    def _manual_control(self, message: Any) -> None:
        for channel, value, sign in ((1, message.y, 1), (2, message.x, -1), (4, message.r, 1)):
            if abs(value) <= 1000:
                self._vehicle.stick(channel, 1500.0 + sign * 0.5 * value)
        if 0 <= message.z <= 1000:
            self._vehicle.stick(3, 1000.0 + message.z)

    def _set_position_target_local_ned(self, message: Any) -> None:
        frame, now = message.coordinate_frame, self._vehicle.status()
        if frame not in LOCAL_FRAMES and frame not in BODY_FRAMES:
            return
        north, east, speed = message.x, message.y, (message.vx, message.vy)
        if frame in BODY_FRAMES:
            yaw = now.attitude_rad[2]
            north, east, speed = *_turned(north, east, yaw), _turned(*speed, yaw)
        if frame not in (1, 8):
            north, east = north + now.position_m[0], east + now.position_m[1]
        height = -message.z if frame == 1 else now.altitude_m - message.z
        self._steer(message.type_mask, (north, east, height), (*speed, -message.vz))

    def _set_position_target_global_int(self, message: Any) -> None:
        lat, lon = message.lat_int / 1e7, message.lon_int / 1e7
        if message.type_mask & POSITION_IGNORED == 0 and (abs(lat) > 90.0 or abs(lon) > 180.0):
            return
        north, east = to_local(lat, lon, *self._vehicle.origin[:2])
        self._steer(message.type_mask, (north, east, message.alt), (message.vx, message.vy, -message.vz))

    def _steer(self, mask: int, place: tuple[float, float, float], speed: tuple[float, float, float]) -> None:
        if mask & POSITION_IGNORED == 0 and all(map(math.isfinite, place)):
            self._vehicle.go_to(*place)
        elif mask & SPEED_IGNORED == 0 and all(map(math.isfinite, speed)):
            self._vehicle.fly_at(*speed)

    # -- the rest -------------------------------------------------------------------------------------------------

    def _ping(self, message: Any) -> None:
        if message.target_system == 0:
            peer = (message.get_srcSystem(), message.get_srcComponent())
            self._link.ping_send(message.time_usec, message.seq, *peer)

    def _timesync(self, message: Any) -> None:
        if message.tc1 == 0:
            self._link.timesync_send(round(self._vehicle.status().time_s * 1e9), message.ts1)


def _text(name: Any) -> str:
    return name.decode(errors="replace") if isinstance(name, bytes) else str(name).rstrip("\x00")


def _turned(forward: float, right: float, yaw: float) -> tuple[float, float]:
    return forward * math.cos(yaw) - right * math.sin(yaw), forward * math.sin(yaw) + right * math.cos(yaw)
