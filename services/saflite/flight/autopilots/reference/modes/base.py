"""What a flight mode is."""

from __future__ import annotations

import math
from typing import ClassVar

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.flight_stack import FlightStack

TICK_S = 0.02
LEASH_M = 2.0  # how far a pilot's target height may be ahead of the vehicle


class Mode:
    """One flight mode; made anew each time it is entered."""

    name: ClassVar[str] = ""
    autonomous: ClassVar[bool] = False
    needs_position: ClassVar[bool] = False
    manual_throttle: ClassVar[bool] = False

    def __init__(self, ap: FlightStack) -> None:
        self.ap, self.board = ap, ap.board
        self._take_off_to_m = -1000.0  # height of a pilot's take-off under way

    def why_not(self) -> str:
        """Return why the mode cannot be entered now, empty if it can."""
        if self.needs_position and (self.board["position_ok"] == 0.0 or self.ap.failsafes.position):
            return "requires position"
        return ""

    def enter(self, previous: Mode) -> None:
        """Begin. `previous` is the mode left."""

    def leave(self) -> None:
        """End."""

    def run(self) -> None:
        """Decide for the next 20 ms."""
        raise NotImplementedError

    def disarmed(self) -> None:
        """The motors were stopped."""

    def may_arm(self) -> bool:
        """Return whether the vehicle may be armed in this mode."""
        return True

    def may_disarm(self) -> bool:
        """Return whether an idle vehicle on the ground is disarmed after DISARM_DELAY."""
        return True

    def disarms_on_landing(self) -> bool:
        """Return whether standing on the ground ends the flight at once: where set so, after a flight."""
        return self.ap.taken_off and int(self.ap.parameters["PILOT_THR_BHV"]) & 4 != 0

    def shift(self, north_m: float, east_m: float) -> None:
        """The estimate jumped by this much: move what is held."""

    def under_way(self) -> bool:
        """Return whether the mode is on its way to a place it was ordered to."""
        return False

    # -- shared by the modes a pilot flies ------------------------------------------------------------------------

    def pilot_angles(self) -> None:
        """Lean and turn as the sticks ask."""
        radio, limit = self.ap.radio, math.radians(self.ap.parameters["ANGLE_MAX"] / 100.0)
        roll, pitch = radio.deflection(1) * limit, radio.deflection(2) * limit
        size = math.hypot(roll, pitch)
        if size > limit:
            roll, pitch = roll * limit / size, pitch * limit / size
        steer.angles(self.board, roll, pitch)
        self.pilot_yaw()

    def pilot_yaw(self) -> None:
        """Turn as the yaw stick asks."""
        steer.yaw_rate(self.board, self.ap.radio.deflection(4) * math.radians(self.ap.parameters["PILOT_Y_RATE"]))

    def hold_altitude_here(self) -> None:
        """Aim at the height the vehicle would come to rest at."""
        climb = self.board["climb_est_mps"]
        ahead_m = 0.4 * climb
        if climb > 0.0:  # a fast climb takes longer (AC_PosControl::init_z_controller_stopping_point)
            ahead_m = max(ahead_m, climb * climb / (2.0 * self.ap.parameters["WPNAV_ACCEL_Z"] / 100.0))
        self.board["set_altitude"] = self.board["altitude_est_m"] + ahead_m

    def pilot_climb(self) -> None:
        """Move the target height as the throttle stick asks; the target never runs far ahead of the vehicle."""
        ap, board, p = self.ap, self.board, self.ap.parameters
        rate = ap.radio.climb_mps()
        if ap.landed and rate <= 0.0:
            self._take_off_to_m = -1000.0
            self.stay_on_ground()
            return
        if ap.armed:
            ap.lift()
        if ap.landed and self._take_off_to_m == -1000.0:  # above where it stands (ArduCopter: _TakeOff::start)
            self._take_off_to_m = board["altitude_est_m"] + p["PILOT_TKOFF_ALT"] / 100.0
        if rate < 0.0:
            self._take_off_to_m = -1000.0  # the pilot breaks it off (ArduCopter: do_pilot_takeoff)
        if board["altitude_est_m"] < self._take_off_to_m:
            rate = max(rate, 0.5 * p["PILOT_SPEED_UP"] / 100.0)
        else:
            self._take_off_to_m = -1000.0
        rate = ap.failsafes.limit_climb(rate)
        change = p["PILOT_ACCEL_Z"] / 100.0 * TICK_S
        rate = min(board["set_climb"] + change, max(board["set_climb"] - change, rate))
        height = board["altitude_est_m"]
        target = board["set_altitude"] + rate * TICK_S
        if rate != 0.0:
            target = min(height + LEASH_M, max(height - LEASH_M, target))
        down = (p["PILOT_SPEED_DN"] or p["PILOT_SPEED_UP"]) / 100.0
        steer.altitude(board, target, p["PILOT_SPEED_UP"] / 100.0 + 0.5, down + 0.5, rate)

    def stay_on_ground(self) -> None:
        """Motors idle, everything reset, until the pilot asks to climb."""
        board = self.board
        board["motors_on"] = 1.0 if self.ap.armed else 0.0
        board["reset_loops"] = 1.0
        steer.throttle(board, 0.0)
        board.set(set_altitude=board["altitude_est_m"], set_climb=0.0)

    def hold_heading(self) -> None:
        """Keep the present heading target."""
        steer.yaw_rate(self.board, 0.0)
