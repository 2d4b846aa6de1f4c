"""LOITER: sticks ask for speed over ground; centred, the vehicle brakes and holds its place. After mode_loiter.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import TICK_S, Mode


class Loiter(Mode):
    """Place and height held, moved by stick."""

    name = "LOITER"
    needs_position = True

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self._held: tuple[float, float] | None = None
        self._speed = (0.0, 0.0)

    def enter(self, previous: Mode) -> None:
        """Brake from the present speed, hold the present height."""
        self.hold_altitude_here()
        self.board["set_climb"] = 0.0
        self._speed = (self.board["est_vn"], self.board["est_ve"])

    def shift(self, north_m: float, east_m: float) -> None:
        """Hold the same ground, not the same numbers."""
        if self._held is not None:
            self._held = (self._held[0] + north_m, self._held[1] + east_m)

    def run(self) -> None:
        """Move the held place as the sticks ask."""
        self.pilot_yaw()
        self.pilot_climb()
        self.move(self.ap.radio.deflection(2), self.ap.radio.deflection(1))

    def drag(self, place: tuple[float, float], altitude_m: float) -> None:
        """Hold somewhere else (only the planted defect reposition-in-hold asks this)."""
        self._held = place
        self.board["set_altitude"] = altitude_m

    def move(self, pitch_stick: float, roll_stick: float) -> None:
        """Fly by stick, or stop and hold."""
        p, board = self.ap.parameters, self.board
        asked = pitch_stick != 0.0 or roll_stick != 0.0
        top = p["LOIT_SPEED"] / 100.0
        yaw = board["est_yaw"]
        size = max(1.0, math.hypot(pitch_stick, roll_stick))  # over ground LOIT_SPEED holds in every direction
        forward, right = -pitch_stick * top / size, roll_stick * top / size
        want = self.ap.failsafes.limit_speed(
            forward * math.cos(yaw) - right * math.sin(yaw), forward * math.sin(yaw) + right * math.cos(yaw)
        )
        change = (p["LOIT_ACC_MAX"] if asked else p["LOIT_BRK_ACCEL"]) / 100.0 * TICK_S
        self._speed = _towards(self._speed, want, change)
        moving = math.hypot(board["est_vn"], board["est_ve"]) > 0.6
        if asked or math.hypot(*self._speed) > 0.1 or (moving and self._held is None):
            self._held = None
            steer.velocity(board, *self._speed)
            return
        if self._held is None:
            self._held = (board["est_n"], board["est_e"])
        steer.position(board, *self._held, top)


def _towards(now: tuple[float, float], want: tuple[float, float], change: float) -> tuple[float, float]:
    gap = math.hypot(want[0] - now[0], want[1] - now[1])
    if gap <= change:
        return want
    return now[0] + (want[0] - now[0]) * change / gap, now[1] + (want[1] - now[1]) * change / gap


MODE = Loiter
