"""FLIP: one full roll or pitch turn, then back to the mode before. After ArduCopter mode_flip.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import steer
from saflite.flight.autopilots.reference.modes.base import TICK_S, Mode

RATE_RPS = math.radians(400.0)
LIMIT_S, CLIMB_SHARE, RECOVERED_RAD = 2.5, 0.2, math.radians(5.0)
LEFT_STICK = 0.2  # deflection to the left that asks for a left roll; a trim set off centre must not
LEAN_MAX_RAD, HEIGHT_MIN_M, THROTTLE_MIN_PWM = math.radians(45.0), 10.0, 1500.0


class Flip(Mode):
    """Enters from ACRO or ALT_HOLD, leaning up to 45 degrees, throttle at or above mid, 10 m or higher."""

    name = "FLIP"

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self._from = ""
        self._phase = "start"
        self._since_s = 0.0
        self._start = (0.0, 0.0, 0.0)
        self._altitude_target = 0.0
        self._axis = 0
        self._way = 1.0
        self._turned = 0.0

    def why_not(self) -> str:
        """Return which entry condition does not hold."""
        ap, board = self.ap, self.board
        lax, laxer = "flip-entry-unchecked" in ap.defects, "flip-from-any-mode" in ap.defects
        rules = (
            (not ap.armed or ap.landed, "must be flying"),
            (not laxer and ap.mode.name not in ("ACRO", "ALT_HOLD"), "only from ACRO or ALT_HOLD"),
            (not lax and abs(board["est_roll"]) > LEAN_MAX_RAD, "leaning too far"),
            (not lax and ap.radio.received[3] < THROTTLE_MIN_PWM, "throttle too low"),
            (not lax and board["altitude_est_m"] < HEIGHT_MIN_M, "too low"),
        )
        return next((text for bad, text in rules if bad), "")

    def enter(self, previous: Mode) -> None:
        """Choose the axis by the sticks: right roll where nothing is asked."""
        board, radio = self.board, self.ap.radio
        self._from = previous.name
        self._since_s = self.ap.time_s
        self._start = (board["est_roll"], board["est_pitch"], board["est_yaw"])
        self._altitude_target = (
            board["set_altitude"] if board["want_z"] == steer.Z_ALTITUDE else board["altitude_est_m"]
        )
        roll, pitch = radio.deflection(1), radio.deflection(2)
        if abs(roll) <= LEFT_STICK and abs(pitch) > 0.3:
            self._axis, self._way = 1, math.copysign(1.0, pitch)
        else:
            self._way = -1.0 if roll < -LEFT_STICK or "flip-rolls-left" in self.ap.defects else 1.0

    def may_arm(self) -> bool:
        """Not on the ground."""
        return False

    def run(self) -> None:
        """Climb a little, turn, recover."""
        board = self.board
        late = self.ap.time_s - self._since_s > LIMIT_S
        if not self.ap.armed or late:
            self._give_up()
            return
        lift = board["hover"] + CLIMB_SHARE * (1.0 - board["hover"])
        rate = board["est_p"] if self._axis == 0 else board["est_q"]
        self._turned += self._way * rate * TICK_S
        if self._phase == "start":
            self._turn(lift)
            if self._turned > math.radians(45.0):
                self._phase = "turn"
        elif self._phase == "turn":
            self._turn(0.3 * board["hover"])
            if self._turned > math.radians(360.0 - 75.0):
                self._phase = "recover"
        else:
            self._recover(lift)

    def _turn(self, throttle: float) -> None:
        rate = self._way * RATE_RPS
        steer.rates(self.board, rate if self._axis == 0 else 0.0, rate if self._axis == 1 else 0.0, 0.0)
        steer.throttle(self.board, throttle)

    def _recover(self, lift: float) -> None:
        board = self.board
        steer.angles(board, self._start[0], self._start[1])
        steer.heading(board, self._start[2])
        steer.throttle(board, lift)
        roll_error = abs(board["est_roll"] - self._start[0])
        pitch_error = abs(board["est_pitch"] - self._start[1])
        if max(roll_error, pitch_error) < RECOVERED_RAD:
            self._back("flip complete")

    def _give_up(self) -> None:
        self.ap.say("Flip failed", "warning")
        self._back("flip abandoned")

    def _back(self, reason: str) -> None:
        self.ap.set_mode(self._from, reason)
        if self._from == "ALT_HOLD" and "flip-wrong-altitude" in self.ap.defects:
            self.board["set_altitude"] = self._altitude_target + self.ap.parameters["GND_ALT_OFFSET"]


MODE = Flip
