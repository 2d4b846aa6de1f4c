"""LAND: straight down, slower below LAND_ALT_LOW, then disarm. After ArduCopter mode_land.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import Mode

SLOWING_M_PER_MPS = 0.5  # start to slow down this far above LAND_ALT_LOW per m/s of speed to lose
BRAKING_MPS2, BRAKING_LEAST_S = 2.0, 0.5
SLOW_MPS, NEAR_M = 0.5, 0.1  # what is slower over ground may touch down; heights are not known better
GIVEN_UP_M = 0.5  # a vehicle that touches the ground this far from its place stays where it is


def stopping_point(mode: Mode) -> tuple[float, float]:
    """Return where the vehicle comes to rest when it brakes now."""
    board = mode.board
    speed_mps = math.hypot(board["est_vn"], board["est_ve"])
    ahead_s = max(BRAKING_LEAST_S, speed_mps / (2.0 * BRAKING_MPS2))
    return board["est_n"] + ahead_s * board["est_vn"], board["est_e"] + ahead_s * board["est_ve"]


def descend(mode: Mode) -> None:
    """Ask for the descent speed of a landing at the present height, level once the ground carries the vehicle.

    It sinks no faster than it can stop over ground before it touches down.

    Who pulls on towards a place from the ground tips over (ArduCopter: AC_PosControl::soften_for_landing_xy).
    """
    p, board = mode.ap.parameters, mode.board
    low, high = p["LAND_SPEED"] / 100.0, (p["LAND_SPEED_HIGH"] or p["WPNAV_SPEED_DN"]) / 100.0
    height = board["altitude_est_m"]
    above = height - p["LAND_ALT_LOW"] / 100.0
    if "land-fast" in mode.ap.defects:
        above = 100.0
    rate = low if above <= 0.0 else min(max(high, low), low + 2.0 * above * SLOWING_M_PER_MPS)
    if board["want_xy"] == steer.XY_POSITION:
        speed_mps = math.hypot(board["est_vn"], board["est_ve"])
        if speed_mps > SLOW_MPS:
            rate = min(rate, max(height, NEAR_M) * BRAKING_MPS2 / speed_mps)
        off_m = math.hypot(board["set_n"] - board["est_n"], board["set_e"] - board["est_e"])
        if mode.ap.landing.touching and off_m > GIVEN_UP_M:
            steer.angles(board, 0.0, 0.0)
    steer.climb(board, -rate)


class Land(Mode):
    """Down here; without a position estimate level, drifting with the wind."""

    name = "LAND"
    autonomous = True

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self._place: tuple[float, float] | None = None

    def enter(self, previous: Mode) -> None:
        """Stop here."""
        board = self.board
        if board["position_ok"] != 0.0:
            self._place = stopping_point(self)
        self.hold_heading()

    def may_arm(self) -> bool:
        """A landing does not begin on the ground."""
        return False

    def disarms_on_landing(self) -> bool:
        """Motors off on the ground, also of a vehicle that never left it. After ArduCopter mode_land.cpp."""
        return True

    def shift(self, north_m: float, east_m: float) -> None:
        """Hold the same ground, not the same numbers."""
        if self._place is not None:
            self._place = (self._place[0] + north_m, self._place[1] + east_m)

    def run(self) -> None:
        """Come down."""
        board = self.board
        if board["position_ok"] == 0.0:
            self._place = None
        if self._place is not None:
            steer.position(board, *self._place, 3.0)
            steer.yaw_rate(board, 0.0)
        else:
            self.pilot_angles()
        if self.ap.landed and not self.ap.taken_off:
            self.stay_on_ground()
        else:
            descend(self)


MODE = Land
