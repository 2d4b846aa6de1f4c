"""The client side of a MAVLink link: what a ground station or a test does to an autopilot, each order with a deadline.

Nothing here sleeps: a client waits only for bytes on its links, and looks at the clock handed in. Whoever steps a
simulation in lockstep hands in ports whose `exchange` steps it and a clock that tells its time.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from saflite.contract.clock import Clock
from saflite.contract.test_case import Mission
from saflite.flight.mavlink.items import ORDERED_PLACES, command_int_fields, item_fields
from saflite.flight.mavlink.ports import Port

GROUND_STATION, INVALID_AUTOPILOT = 6, 8
ARDUPILOT, PX4 = 3, 12  # MAV_AUTOPILOT
HEARTBEAT_EVERY_S, STICKS_EVERY_S, REPEAT_S, WAIT_S = 1.0, 0.2, 0.5, 0.02
ACCEPTED, TEMPORARILY_REJECTED, IN_PROGRESS = 0, 1, 5
DO_SET_MODE, CUSTOM_MODE = 176, 1
WHOLE = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}  # MAV_PARAM_TYPE of whole numbers
NOT_GIVEN, RELEASED = 65535, 0
TEXTS_MAX, TEXT_CHARS_MAX = 1000, 12_800  # as long as 256 parts of a text can be


class Answer(NamedTuple):
    """What became of an order: `result` is the autopilot's own number, None where it did not answer in time."""

    state: Literal["accepted", "denied", "timed_out"]
    result: int | None = None
    value: float | None = None  # of a parameter, as read back
    sends: int = 1
    item: int | None = None  # of a mission: the last one asked for

    @property
    def ok(self) -> bool:
        """Whether it was accepted."""
        return self.state == "accepted"


class Client:
    """One vehicle over one link that is talked on, and others that are only read so that their writers never stall.

    Args:
        clock: deadlines, heartbeats and repeats run on it.
        link: talked on.
        drained: read and kept alive with heartbeats, nothing else.
        vehicle: system and component of the vehicle.
        own: system and component of this client.
    """

    def __init__(
        self,
        clock: Clock,
        link: Port,
        *drained: Port,
        vehicle: tuple[int, int] = (1, 1),
        own: tuple[int, int] = (255, 190),
    ) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self._clock, self._ports = clock, (link, *drained)
        self._vehicle = vehicle
        self._out = bytearray()
        self.mav: Any = ardupilotmega.MAVLink(self, srcSystem=own[0], srcComponent=own[1])
        self._readers = [ardupilotmega.MAVLink(None) for _ in self._ports]
        for reader in self._readers:
            reader.robust_parsing = True
        self._heartbeat_due_s = self._sticks_due_s = clock.monotonic_s()
        self._sticks: dict[int, int] = {}
        self.latest: dict[str, Any] = {}
        self.texts: deque[str] = deque(maxlen=TEXTS_MAX)

    def write(self, data: bytes) -> None:
        """Take bytes that pymavlink packed."""
        self._out += data

    # -- the link -------------------------------------------------------------------------------------------------

    def poll(self, wait_s: float = 0.0) -> list[Any]:
        """Send what waits and what is due, read every link, return the vehicle's messages on the first.

        Raises:
            Unavailable: the peer has hung up.
        """
        beat = self._regular()
        data, self._out = bytes(self._out), bytearray()
        found: list[Any] = []
        for place, (port, reader) in enumerate(zip(self._ports, self._readers, strict=True)):
            received = port.exchange(beat if place else data, 0.0 if place else wait_s)
            messages = reader.parse_buffer(received) or ()
            found += messages if place == 0 else ()
        return [message for message in found if self._note(message)]

    def _regular(self) -> bytes:
        """Pack what is sent regularly; return the heartbeat if it is due, for the other links."""
        now_s, before = self._clock.monotonic_s(), len(self._out)
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + HEARTBEAT_EVERY_S
            self.mav.heartbeat_send(GROUND_STATION, INVALID_AUTOPILOT, 0, 0, 0)
        beat = bytes(self._out[before:])
        if self._sticks and now_s >= self._sticks_due_s:
            self._sticks_due_s = now_s + STICKS_EVERY_S
            self.mav.rc_channels_override_send(*self._vehicle, *(self._sticks.get(i, NOT_GIVEN) for i in range(1, 9)))
        return beat

    def _note(self, message: Any) -> bool:
        """Remember a message; return whether it is the vehicle's own."""
        kind = message.get_type()
        if kind == "BAD_DATA" or message.get_srcSystem() != self._vehicle[0]:
            return False
        if kind == "HEARTBEAT" and message.get_srcComponent() != self._vehicle[1]:
            return False
        self.latest[kind] = message
        if kind == "STATUSTEXT":
            if message.chunk_seq and self.texts:  # the rest of a long one
                self.texts[-1] += message.text[: max(0, TEXT_CHARS_MAX - len(self.texts[-1]))]
            else:
                self.texts.append(message.text)
        return True

    def wait(
        self, good: Callable[[Any], bool], within_s: float, send: Callable[[int], None] = lambda sends: None
    ) -> tuple[Any | None, int]:
        """Poll until a message is good; return it, None at the deadline, and how often `send` was called.

        `send` gives the order: at once, and every half second until then. It is told how often it was called before.
        """
        now_s = self._clock.monotonic_s()
        end_s, due_s, sends = now_s + within_s, now_s, 0
        while now_s < end_s:
            if now_s >= due_s:
                send(sends)
                sends, due_s = sends + 1, now_s + REPEAT_S
            found = next(filter(good, self.poll(min(WAIT_S, end_s - now_s))), None)
            if found is not None:
                return found, sends
            now_s = self._clock.monotonic_s()
        return None, sends

    def wait_for_heartbeat(self, within_s: float) -> bool:
        """Return whether the vehicle is on the link."""
        return self.wait(lambda message: message.get_type() == "HEARTBEAT", within_s)[0] is not None

    @property
    def autopilot(self) -> int:
        """MAV_AUTOPILOT of the vehicle by its last heartbeat, 0 (generic) before."""
        beat = self.latest.get("HEARTBEAT")
        return 0 if beat is None else int(beat.autopilot)

    # -- orders ---------------------------------------------------------------------------------------------------

    def set_parameter(self, name: str, value: float, within_s: float) -> Answer:
        """Set a parameter and read it back; denied where the vehicle keeps another value.

        The type is asked for first: PX4 sends the bytes of a whole number where others send its value.
        """
        end_s = self._clock.monotonic_s() + within_s
        before, sends = self._parameter(name, within_s, lambda: self._read_parameter(name))
        if before is None:
            return Answer("timed_out", sends=sends)
        sent, kind = self.encoded(value, before.param_type), before.param_type
        rest_s = end_s - self._clock.monotonic_s()
        found, sends = self._parameter(
            name, rest_s, lambda: self.mav.param_set_send(*self._vehicle, name.encode(), sent, kind)
        )
        if found is None:
            return Answer("timed_out", sends=sends)
        taken = struct.pack("<f", found.param_value) == struct.pack("<f", sent)
        read = self.decoded(found.param_value, found.param_type)
        return Answer("accepted" if taken else "denied", value=read, sends=sends)

    def parameter(self, name: str, within_s: float) -> float | None:
        """Return a parameter's value, None where the vehicle does not tell it."""
        found, _ = self._parameter(name, within_s, lambda: self._read_parameter(name))
        return None if found is None else self.decoded(found.param_value, found.param_type)

    def _parameter(self, name: str, within_s: float, order: Callable[[], None]) -> tuple[Any | None, int]:
        return self.wait(
            lambda message: message.get_type() == "PARAM_VALUE" and message.param_id == name,
            within_s,
            lambda sends: order(),
        )

    def _read_parameter(self, name: str) -> None:
        self.mav.param_request_read_send(*self._vehicle, name.encode(), -1)

    def _bytewise(self, kind: int) -> bool:
        return kind in WHOLE and self.autopilot == PX4

    def encoded(self, value: float, kind: int) -> float:
        """Return a parameter's value as this autopilot takes it in a message; `kind` is its MAV_PARAM_TYPE."""
        if not self._bytewise(kind):
            return value
        packed: float = struct.unpack("<f", struct.pack("<" + WHOLE[kind], round(value)).ljust(4, b"\0"))[0]
        return packed

    def decoded(self, value: float, kind: int) -> float:
        """Return the value that a number in a message of this autopilot stands for."""
        if not self._bytewise(kind):
            return value
        return float(struct.unpack_from("<" + WHOLE[kind], struct.pack("<f", value))[0])

    def send_command(self, number: int, numbers: Sequence[float], confirmation: int = 0) -> None:
        """Send a MAV_CMD with up to seven numbers; nothing is waited for.

        ArduPilot takes places as COMMAND_INT, which says what their height counts from: here from home. As COMMAND_LONG
        it refuses DO_REPOSITION, and counts the height of DO_SET_HOME from the sea. NaN is 0 to it, as in its own
        conversion (`GCS_Common.cpp`, convert_COMMAND_LONG_to_COMMAND_INT). PX4 takes the numbers of both alike.
        """
        if number in ORDERED_PLACES and self.autopilot == ARDUPILOT:
            self.mav.command_int_send(*self._vehicle, *command_int_fields(number, numbers))
        else:
            padded = [*numbers, *([0.0] * 7)][:7]
            self.mav.command_long_send(*self._vehicle, number, confirmation, *padded)

    def command(self, number: int, numbers: Sequence[float], within_s: float) -> Answer:
        """Give a MAV_CMD with up to seven numbers, repeated until acknowledged. Work in progress is waited for."""

        def final(message: Any) -> bool:
            known = message.get_type() == "COMMAND_ACK" and message.command == number
            return bool(known and message.result != IN_PROGRESS)

        found, sends = self.wait(
            final, within_s, lambda sends: self.send_command(number, numbers, confirmation=min(sends, 255))
        )
        if found is None:
            return Answer("timed_out", sends=sends)
        return Answer("accepted" if found.result == ACCEPTED else "denied", int(found.result), sends=sends)

    def set_mode(self, custom_mode: int, within_s: float) -> Answer:
        """Change the mode and wait until the heartbeat tells it; the number is the heartbeat's `custom_mode`."""
        end_s = self._clock.monotonic_s() + within_s
        numbers = (custom_mode >> 16 & 0xFF, custom_mode >> 24) if self.autopilot == PX4 else (custom_mode,)
        answer = self.command(DO_SET_MODE, (CUSTOM_MODE, *numbers), within_s)
        if not answer.ok:
            return answer
        told, _ = self.wait(
            lambda message: message.get_type() == "HEARTBEAT" and message.custom_mode == custom_mode,
            end_s - self._clock.monotonic_s(),
        )
        return answer if told is not None else Answer("timed_out", sends=answer.sends)

    def upload(self, mission: Mission, within_s: float) -> Answer:
        """Replace the mission on board. ArduPilot takes the home place before the items and 0 for "not given"."""
        end_s = self._clock.monotonic_s() + within_s
        if not self.autopilot:
            self.wait_for_heartbeat(within_s)
        ardupilot = self.autopilot == ARDUPILOT
        rows = item_fields(mission, home=ardupilot, not_given=0.0 if ardupilot else math.nan)
        kinds = ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK")
        asked, sends = -1, 0  # the item asked for last; -1 before the first
        while self._clock.monotonic_s() < end_s:
            message, more = self.wait(
                lambda message: message.get_type() in kinds and getattr(message, "mission_type", 0) == 0,
                end_s - self._clock.monotonic_s(),
                lambda sends, asked=asked: self._send_item(rows, asked),  # type: ignore[misc]
            )
            sends += more
            if message is None:
                break
            if message.get_type() == "MISSION_ACK":
                state: Literal["accepted", "denied"] = "accepted" if message.type == ACCEPTED else "denied"
                return Answer(state, int(message.type), sends=sends, item=asked if asked >= 0 else None)
            asked = message.seq if message.seq < len(rows) else asked
        return Answer("timed_out", sends=sends)

    def _send_item(self, rows: Sequence[tuple[float, ...]], index: int) -> None:
        if index < 0:
            self.mav.mission_count_send(*self._vehicle, len(rows), 0)
        else:
            self.mav.mission_item_int_send(*self._vehicle, index, *rows[index], 0)

    def override(self, sticks_pwm: Mapping[int, float]) -> None:
        """Hold these channels (1 to 8) of the radio, sent anew every 0.2 s by `poll`; the others stay as they are."""
        self._sticks.update({channel: round(pwm) for channel, pwm in sticks_pwm.items()})
        self._sticks_due_s = self._clock.monotonic_s()

    def release(self) -> None:
        """Give all held channels back to the radio."""
        if self._sticks:
            released = (RELEASED if i in self._sticks else NOT_GIVEN for i in range(1, 9))
            self.mav.rc_channels_override_send(*self._vehicle, *released)
        self._sticks = {}

    def close(self) -> None:
        """Send what waits and close every link."""
        self.poll()
        for port in self._ports:
            port.close()
