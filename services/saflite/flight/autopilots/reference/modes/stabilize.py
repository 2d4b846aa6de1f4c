"""STABILIZE: the pilot leans the vehicle and sets the throttle. After ArduCopter mode_stabilize.cpp."""

from __future__ import annotations

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import Mode


def stick_throttle(mode: Mode) -> float:
    """Return the collective for the throttle stick: mid stick hovers."""
    stick, hover = mode.ap.radio.throttle(), mode.board["hover"]
    return stick / 0.5 * hover if stick < 0.5 else hover + (stick - 0.5) / 0.5 * (1.0 - hover)


class Stabilize(Mode):
    """Angles and throttle by stick."""

    name = "STABILIZE"
    manual_throttle = True

    def run(self) -> None:
        """Pass the sticks on."""
        if self.ap.landed and self.ap.radio.throttle() < 0.1:
            self.stay_on_ground()
        elif self.ap.armed:
            self.ap.lift()
        self.pilot_angles()
        steer.throttle(self.board, stick_throttle(self))


MODE = Stabilize
