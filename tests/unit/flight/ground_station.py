"""A ground station that talks to the served reference vehicle in memory, without a socket."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from saflite.flight.autopilots.reference.sitl import Session, on_the_ground

ACCEPTED = dialect.MAV_RESULT_ACCEPTED


class Station:
    """A ground station that talks to a session in memory."""

    def __init__(self) -> None:
        self.session = Session(on_the_ground())
        self.out = bytearray()
        self.mav = dialect.MAVLink(self, srcSystem=255, srcComponent=190)
        self._reader = dialect.MAVLink(None)

    def write(self, data: bytes) -> None:
        self.out += data

    def run(self, ticks: int = 1) -> list[Any]:
        """Send what waits, fly, and return the messages that came back."""
        found: list[Any] = []
        for _ in range(ticks):
            data, self.out = bytes(self.out), bytearray()
            self.session.feed(data)
            found += self._reader.parse_buffer(self.session.step()) or []
        return found

    def order(self, number: int, *values: float) -> int:
        self.mav.command_long_send(1, 1, number, 0, *[*values, *([0.0] * 7)][:7])
        answers = [m for m in self.run(2) if m.get_type() == "COMMAND_ACK" and m.command == number]
        assert len(answers) == 1
        return int(answers[0].result)

    def take_off(self) -> None:
        """Fly at 5 m in GUIDED."""
        assert self.order(176, 1, 4) == self.order(400, 1) == self.order(22, 0, 0, 0, 0, 0, 0, 5) == ACCEPTED
        self.run(300)

    def upload(self, *rows: tuple[int, float, float, float]) -> int:
        """Send a mission of (command, latitude, longitude, altitude) and return the result."""
        self.mav.mission_count_send(1, 1, len(rows))
        for index, (number, lat, lon, height) in enumerate(rows):
            self.run(2)
            self.mav.mission_item_send(1, 1, index, 3, number, 0, 1, 0, 0, 0, 0, lat, lon, height)
        return acknowledged(self.run(2))[-1]


def acknowledged(messages: list[Any]) -> list[int]:
    return [m.type for m in messages if m.get_type() == "MISSION_ACK"]


def asked(messages: list[Any]) -> list[int]:
    return [m.seq for m in messages if m.get_type() == "MISSION_REQUEST_INT"]
