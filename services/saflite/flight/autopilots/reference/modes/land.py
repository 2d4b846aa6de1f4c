"""LAND: straight down, slower below LAND_ALT_LOW, then disarm. After ArduCopter mode_land.cpp."""

from __future__ import annotations

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import Mode

SLOWING_M_PER_MPS = 0.5  # start to slow down this far above LAND_ALT_LOW per m/s of speed to lose


def descend(mode: Mode) -> None:
    """Ask for the descent speed of a landing at the present height."""
    p, board = mode.ap.parameters, mode.board
    low, high = p["LAND_SPEED"] / 100.0, (p["LAND_SPEED_HIGH"] or p["WPNAV_SPEED_DN"]) / 100.0
    height = board["altitude_est_m"]
    above = height - p["LAND_ALT_LOW"] / 100.0
    if "land-fast" in mode.ap.defects:
        above = 100.0
    rate = low if above <= 0.0 else min(max(high, low), low + 2.0 * above * SLOWING_M_PER_MPS)
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
            self._place = (board["est_n"] + 0.5 * board["est_vn"], board["est_e"] + 0.5 * board["est_ve"])
        self.hold_heading()

    def may_arm(self) -> bool:
        """A landing does not begin on the ground."""
        return False

    def disarms_on_landing(self) -> bool:
        """A landing ends with motors off."""
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
