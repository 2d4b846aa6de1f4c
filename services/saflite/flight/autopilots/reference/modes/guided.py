"""GUIDED: a ground station sends take-offs, places and speeds. After ArduCopter mode_guided.cpp."""

from __future__ import annotations

from saflite.flight.autopilots.reference import settings, steer
from saflite.flight.autopilots.reference.modes.base import Mode

REACHED_M = 0.5
SPEED_ORDER_S = 3.0  # a speed order runs out, as in ArduCopter


class Guided(Mode):
    """Take-off, go to, fly at; holds its place where nothing is asked."""

    name = "GUIDED"
    autonomous = True
    needs_position = True

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self.target: tuple[float, float, float] | None = None
        self.speed: tuple[float, float, float] | None = None
        self._speed_until_s = 0.0
        self.taking_off = False
        self._chosen_here = False  # the place was not ordered but is where the vehicle was
        self.yaw_rad: float | None = None

    def enter(self, previous: Mode) -> None:
        """Stop and stay here, nose as it is: orders to turn that were given before do not count any more."""
        self.ap.yaw_order_rad = None
        if not self.ap.landed:
            self._stay_here()

    def shift(self, north_m: float, east_m: float) -> None:
        """Hold the same ground, not the same numbers; a place that was ordered stays where it is."""
        if self.target is not None and self._chosen_here:
            self.target = (self.target[0] + north_m, self.target[1] + east_m, self.target[2])

    def take_off(self, altitude_m: float) -> None:
        """Climb straight up to a height above home."""
        endless = 1e5 if altitude_m <= 0.0 else altitude_m  # only with takeoff-altitude-unchecked
        self.target = (self.board["est_n"], self.board["est_e"], endless)
        self.speed = None
        self.taking_off = self._chosen_here = True
        self.board.set(takeoff=1.0, takeoff_altitude_set_m=altitude_m, set_altitude=self.board["altitude_est_m"])
        self.ap.lift()

    def go_to(self, north_m: float, east_m: float, altitude_m: float) -> None:
        """Fly to a place."""
        self.target, self.speed = (north_m, east_m, altitude_m), None
        self._chosen_here = False
        self.end_take_off()

    def fly_at(self, north_mps: float, east_mps: float, climb_mps: float) -> None:
        """Fly at a speed for three seconds."""
        self.speed, self._speed_until_s = (north_mps, east_mps, climb_mps), self.ap.time_s + SPEED_ORDER_S
        self.end_take_off()

    def end_take_off(self) -> None:
        """The climb is over or was replaced by another order."""
        self.taking_off = False
        self.board["takeoff"] = 0.0

    def may_disarm(self) -> bool:
        """On the ground without an order."""
        return not self.taking_off

    def under_way(self) -> bool:
        """Ordered to a place and not there yet."""
        if self.target is None or self.taking_off:
            return False
        return abs(self.target[0] - self.board["est_n"]) + abs(self.target[1] - self.board["est_e"]) > 2.0

    def run(self) -> None:
        """Fly the order at hand."""
        board = self.board
        if self.target is None and self.ap.landed:
            self.stay_on_ground()
            steer.position(board, board["est_n"], board["est_e"], 1.0)
            return
        plane, up, down = settings.speeds(self.ap)
        if self.speed is not None and self.ap.time_s < self._speed_until_s:
            steer.velocity(board, *self.ap.failsafes.limit_speed(*self.speed[:2]))
            steer.climb(board, min(up, max(-down, self.ap.failsafes.limit_climb(self.speed[2]))))
            return
        if self.target is None or self.speed is not None:
            self._stay_here()
        assert self.target is not None
        steer.position(board, self.target[0], self.target[1], plane)
        steer.altitude(board, self.ap.failsafes.limit_altitude(self.target[2]), up, down)
        self._turn()
        if self.taking_off and board["altitude_est_m"] > self.target[2] - REACHED_M:
            self.end_take_off()

    def _turn(self) -> None:
        if self.ap.yaw_order_rad is not None:
            steer.heading(self.board, self.ap.yaw_order_rad)
        else:
            self.hold_heading()

    def _stay_here(self) -> None:
        self.go_to(*self._stopping_point(), self.board["altitude_est_m"])
        self._chosen_here = True

    def _stopping_point(self) -> tuple[float, float]:
        board = self.board
        return board["est_n"] + 0.8 * board["est_vn"], board["est_e"] + 0.8 * board["est_ve"]


MODE = Guided
