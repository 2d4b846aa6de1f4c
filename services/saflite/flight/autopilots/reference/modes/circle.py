"""CIRCLE: round a centre CIRCLE_RADIUS ahead, nose inwards. After ArduCopter mode_circle.cpp and AC_Circle.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import TICK_S, Mode

RADIUS_RATE_MPS, RADIUS_MAX_M, RATE_CHANGE_DPS = 1.0, 2000.0, 2.0
SPEED_MAX_MPS = 5.0
CURVE_SHARE = 0.5  # of WPNAV_ACCEL may go into the curve, so that it can be held (AC_Circle::calc_velocities)


class Circle(Mode):
    """Pitch changes the radius, roll the speed, throttle the height."""

    name = "CIRCLE"
    autonomous = True
    needs_position = True

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self._centre = (0.0, 0.0)
        self._angle = 0.0
        self._radius_m = 0.0
        self._rate_dps = 0.0
        self._speed_mps = 0.0

    def enter(self, previous: Mode) -> None:
        """The centre lies ahead by the radius."""
        p, board = self.ap.parameters, self.board
        self._radius_m, self._rate_dps = p["CIRCLE_RADIUS"] / 100.0, p["CIRCLE_RATE"]
        yaw = board["est_yaw"]
        self._centre = (
            board["est_n"] + self._radius_m * math.cos(yaw),
            board["est_e"] + self._radius_m * math.sin(yaw),
        )
        self._angle = yaw + math.pi
        self.hold_altitude_here()
        board["set_climb"] = 0.0

    def run(self) -> None:
        """Go on round the circle."""
        if self.ap.landed:
            self.stay_on_ground()
            return
        self._sticks()
        board, radius = self.board, self._radius_m
        want = math.radians(self._rate_dps) * radius
        top = min(SPEED_MAX_MPS, math.sqrt(CURVE_SHARE * self.ap.parameters["WPNAV_ACCEL"] / 100.0 * radius))
        want = min(top, max(-top, want))
        change = 1.0 * TICK_S
        self._speed_mps += min(change, max(-change, want - self._speed_mps))
        turn = self._speed_mps / radius if radius > 0.1 else math.radians(self._rate_dps)
        self._angle += turn * TICK_S
        north, east = self._centre[0] + radius * math.cos(self._angle), self._centre[1] + radius * math.sin(self._angle)
        steer.position(board, north, east, SPEED_MAX_MPS)
        board.set(set_vn=-turn * radius * math.sin(self._angle), set_ve=turn * radius * math.cos(self._angle))
        steer.heading(board, self._angle + math.pi)
        self.pilot_climb()
        board["circle_radius_m"] = radius
        board["circle_rate_dps"] = self._rate_dps

    def _sticks(self) -> None:
        """Pitch forward (below centre) shrinks the circle, back widens it; roll right speeds the turn up."""
        radio = self.ap.radio
        pitch, roll = radio.deflection(2), radio.deflection(1)
        if "circle-radius-reversed" in self.ap.defects:
            pitch = -pitch
        self._radius_m = min(RADIUS_MAX_M, max(0.0, self._radius_m + pitch * RADIUS_RATE_MPS * TICK_S))
        self._rate_dps = min(90.0, max(-90.0, self._rate_dps + roll * RATE_CHANGE_DPS * TICK_S))


MODE = Circle
