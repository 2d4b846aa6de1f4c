"""ALT_HOLD: the pilot leans the vehicle, the autopilot holds the height. After ArduCopter mode_althold.cpp."""

from __future__ import annotations

from saflite.flight.autopilots.reference.modes.base import Mode


class AltHold(Mode):
    """Angles and climb rate by stick; mid throttle holds the height."""

    name = "ALT_HOLD"

    def enter(self, previous: Mode) -> None:
        """Aim at the present height."""
        self.hold_altitude_here()
        self.board["set_climb"] = 0.0

    def run(self) -> None:
        """Pass the sticks on."""
        self.pilot_angles()
        self.pilot_climb()


MODE = AltHold
