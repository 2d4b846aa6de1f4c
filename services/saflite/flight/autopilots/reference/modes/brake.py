"""BRAKE: stop as fast as is safe and stay. After ArduCopter mode_brake.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import Mode

STOPPED_MPS = 0.3


class Brake(Mode):
    """Stop here."""

    name = "BRAKE"
    autonomous = True
    needs_position = True

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self._held: tuple[float, float] | None = None

    def enter(self, previous: Mode) -> None:
        """Keep the height."""
        self.hold_altitude_here()
        self.hold_heading()

    def may_arm(self) -> bool:
        """Nothing to brake on the ground."""
        return False

    def shift(self, north_m: float, east_m: float) -> None:
        """Hold the same ground, not the same numbers."""
        if self._held is not None:
            self._held = (self._held[0] + north_m, self._held[1] + east_m)

    def run(self) -> None:
        """Brake, then hold."""
        board = self.board
        if self.ap.landed:
            self.stay_on_ground()
            return
        steer.altitude(board, board["set_altitude"], 1.5, 1.5)
        if self._held is None and math.hypot(board["est_vn"], board["est_ve"]) < STOPPED_MPS:
            self._held = (board["est_n"], board["est_e"])
        if self._held is not None:
            steer.position(board, *self._held, 3.0)
        elif "brake-keeps-speed" in self.ap.defects:
            steer.velocity(board, board["est_vn"], board["est_ve"])
        else:
            steer.velocity(board, 0.0, 0.0)


MODE = Brake
