"""ACRO: the sticks ask for rates; the trainer levels and limits. After ArduCopter mode_acro.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import Mode
from saflite.flight.autopilots.reference.modes.stabilize import leave_ground, stick_throttle

RATE_PER_P = math.radians(45.0)


class Acro(Mode):
    """Rates by stick."""

    name = "ACRO"
    manual_throttle = True

    def run(self) -> None:
        """Pass the sticks on as rates."""
        leave_ground(self)
        p, radio = self.ap.parameters, self.ap.radio
        roll = self._bend(radio.deflection(1)) * p["ACRO_RP_P"] * RATE_PER_P
        pitch = self._bend(radio.deflection(2)) * p["ACRO_RP_P"] * RATE_PER_P
        yaw = radio.deflection(4) * p["ACRO_YAW_P"] * RATE_PER_P
        if p["ACRO_TRAINER"] >= 1:
            roll -= self._level(self.board["est_roll"], p["ACRO_BAL_ROLL"], roll)
            pitch -= self._level(self.board["est_pitch"], p["ACRO_BAL_PITCH"], pitch)
        steer.rates(self.board, roll, pitch, yaw)
        steer.throttle(self.board, stick_throttle(self, p["ACRO_THR_MID"] or self.board["hover"]))

    def _bend(self, stick: float) -> float:
        bend = self.ap.parameters["ACRO_RP_EXPO"]
        return bend * stick**3 + (1.0 - bend) * stick

    def _level(self, angle: float, gain: float, asked: float) -> float:
        """Return the rate that levels the vehicle; beyond ANGLE_MAX the trainer (2) pulls back hard."""
        limit = math.radians(self.ap.parameters["ANGLE_MAX"] / 100.0)
        back = gain * min(1.0, max(-1.0, angle)) * (1.0 if asked == 0.0 else 0.3)
        if self.ap.parameters["ACRO_TRAINER"] == 2 and abs(angle) > limit:
            back += 4.5 * (angle - math.copysign(limit, angle))
        return back


MODE = Acro
