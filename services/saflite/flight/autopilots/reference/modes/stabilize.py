"""STABILIZE: the pilot leans the vehicle and sets the throttle. After ArduCopter mode_stabilize.cpp."""

from __future__ import annotations

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import Mode


def leave_ground(mode: Mode) -> None:
    """Stand with the throttle stick down, lift off with it up."""
    if mode.ap.landed and mode.ap.radio.throttle() < 0.1:
        mode.stay_on_ground()
    elif mode.ap.armed:
        mode.ap.lift()


def stick_throttle(mode: Mode, middle: float) -> float:
    """Return the collective 0..1 for the throttle stick, given the collective of mid stick."""
    stick = mode.ap.radio.throttle()
    return stick / 0.5 * middle if stick < 0.5 else middle + (stick - 0.5) / 0.5 * (1.0 - middle)


class Stabilize(Mode):
    """Angles and throttle by stick."""

    name = "STABILIZE"
    manual_throttle = True

    def run(self) -> None:
        """Pass the sticks on."""
        leave_ground(self)
        self.pilot_angles()
        steer.throttle(self.board, stick_throttle(self, self.board["hover"]))


MODE = Stabilize
