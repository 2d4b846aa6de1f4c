"""RTL: climb to the return altitude, fly home level, wait, land. After ArduCopter mode_rtl.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import settings, steer
from saflite.flight.autopilots.reference.modes.base import Mode
from saflite.flight.autopilots.reference.modes.land import descend

REACHED_M = 0.5


class Rtl(Mode):
    """Home."""

    name = "RTL"
    autonomous = True
    needs_position = True

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self.phase = "climb"
        self._until_s = 0.0
        self._start = self._home = (0.0, 0.0)
        self._altitude = self._altitude_final = 0.0

    def enter(self, previous: Mode) -> None:
        """Begin with the climb, from here."""
        p, board = self.ap.parameters, self.board
        height = board["altitude_est_m"]
        self._start = (board["est_n"], board["est_e"])
        self._home = (self.ap.home[0], self.ap.home[1])  # another home counts from the next return on
        wanted = max(p["RTL_ALT"] / 100.0, height + p["RTL_CLIMB_MIN"] / 100.0, height)
        # the ceiling may keep it from climbing; even above it a return does not begin with a descent
        self._altitude = max(self.ap.failsafes.limit_altitude(wanted), height)
        if "rtl-altitude-unit" in self.ap.defects:
            self._altitude = self.ap.failsafes.limit_altitude(p["RTL_ALT"] / 1000.0)
        self._altitude_final = p["RTL_ALT_FINAL"] / 100.0
        steer.heading(board, board["est_yaw"])

    def may_arm(self) -> bool:
        """A return does not begin on the ground."""
        return False

    def disarms_on_landing(self) -> bool:
        """A return that lands ends with motors off."""
        return self.phase == "land" and "rtl-stays-armed" not in self.ap.defects

    def run(self) -> None:
        """Fly the phase at hand."""
        if self.ap.landed and not self.ap.taken_off:
            self.stay_on_ground()
            return
        getattr(self, f"_{self.phase}")()

    def _speeds(self) -> tuple[float, float, float]:
        plane, up, down = settings.speeds(self.ap)
        return self.ap.parameters["RTL_SPEED"] / 100.0 or plane, up, down

    def _climb(self) -> None:
        plane, up, down = self._speeds()
        steer.position(self.board, *self._start, plane)
        steer.altitude(self.board, self._altitude, up, down)
        if self.board["altitude_est_m"] > self._altitude - REACHED_M:
            self.phase = "fly"

    def _fly(self) -> None:
        plane, up, down = self._speeds()
        north, east = self._home
        gap_n, gap_e = north - self.board["est_n"], east - self.board["est_e"]
        steer.position(self.board, north, east, plane)
        steer.altitude(self.board, self._altitude, up, down)
        if math.hypot(gap_n, gap_e) > 2.0:
            steer.heading(self.board, math.atan2(gap_e, gap_n))
        elif math.hypot(gap_n, gap_e) < REACHED_M:
            self.phase, self._until_s = "wait", self.ap.time_s + self.ap.parameters["RTL_LOIT_TIME"] / 1000.0

    def _wait(self) -> None:
        plane, up, down = self._speeds()
        steer.position(self.board, *self._home, plane)
        steer.altitude(self.board, self._altitude, up, down)
        if self.ap.time_s >= self._until_s:
            self.phase = "descend" if self._altitude_final > 0.0 else "land"

    def _descend(self) -> None:
        plane, up, down = self._speeds()
        steer.position(self.board, *self._home, plane)
        steer.altitude(self.board, self._altitude_final, up, down)

    def _land(self) -> None:
        steer.position(self.board, *self._home, 3.0)
        descend(self)


MODE = Rtl
