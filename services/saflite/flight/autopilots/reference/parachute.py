"""The parachute: released by command or after loss of control. After AP_Parachute and ArduCopter crash_check.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference.flight_stack import FlightStack

TICK_S = 0.02
SERVO_PARACHUTE = 27
LOST_CONTROL_S, LOST_ANGLE_RAD = 1.0, math.radians(60.0)


class Parachute:
    """DO_PARACHUTE 0 disables, 1 enables, 2 releases."""

    def __init__(self, ap: FlightStack) -> None:
        self._ap = ap
        self.released = False
        self._due_s: float | None = None
        self._lost_s = 0.0
        self._sink_s = 0.0

    def fitted(self) -> bool:
        """Return whether there is a parachute that an output drives."""
        p = self._ap.parameters
        return p["CHUTE_ENABLED"] == 1 and (p["CHUTE_TYPE"] != 10 or p["SERVO9_FUNCTION"] == SERVO_PARACHUTE)

    def why_not(self) -> str:
        """Return why it may not be released now, empty if it may."""
        ap, board = self._ap, self._ap.board
        lax = "parachute-in-flip" in ap.defects
        in_acro = ap.mode.name == "ACRO" and "parachute-in-acro" not in ap.defects
        climbing = board["climb_est_mps"] > 0.3 and "parachute-while-climbing" not in ap.defects
        low_m = ap.parameters["CHUTE_ALT_MIN"]
        rules = (
            (not self.fitted(), "parachute disabled"),
            (self.released, "already released"),
            (not ap.armed and not lax, "not armed"),
            ((ap.mode.name == "FLIP" and not lax) or in_acro, f"mode {ap.mode.name}"),
            (ap.landed and not lax, "landed"),
            (climbing and ap.mode.name != "FLIP", "climbing"),
            (low_m != 0.0 and board["altitude_est_m"] < low_m, "too low"),
        )
        return next((text for bad, text in rules if bad), "")

    def release(self, reason: str) -> str:
        """Release after CHUTE_DELAY_MS; motors stop at once. Return why not, empty if it will."""
        why = self.why_not()
        if why:
            self._ap.say(f"Parachute: {why}", "warning")
            return why
        self._ap.say(f"Parachute: released ({reason})", "error")
        self._due_s = self._ap.time_s + self._ap.parameters["CHUTE_DELAY_MS"] / 1000.0
        self.released = True  # the motors stop with the next tick
        self._ap.board["chute_released"] = 1.0
        return ""

    def open_now(self) -> bool:
        """Return whether the canopy is out."""
        present = self._ap.parameters["SIM_PARA_ENABLE"] == 1
        return self.released and present and self._due_s is not None and self._ap.time_s >= self._due_s

    def tick(self) -> None:
        """Release by itself after one second out of control or sinking too fast."""
        ap, board = self._ap, self._ap.board
        if self.released and ap.armed:
            ap.disarm("parachute")
        if self.released or not self.fitted() or not ap.armed or ap.landed or ap.mode.name in ("FLIP", "ACRO"):
            self._lost_s = self._sink_s = 0.0
            return
        error = math.acos(math.cos(board["est_roll"]) * math.cos(board["est_pitch"]))  # of the thrust from upright
        falling = board["climb_est_mps"] < 0.0
        counted_s = TICK_S if error > LOST_ANGLE_RAD else -TICK_S  # who tumbles is upright in between
        self._lost_s = max(0.0, self._lost_s + counted_s) if falling else 0.0
        sink = ap.parameters["CHUTE_CRT_SINK"]
        self._sink_s = self._sink_s + TICK_S if sink > 0.0 and board["climb_est_mps"] < -sink else 0.0
        if self._lost_s > LOST_CONTROL_S or self._sink_s > LOST_CONTROL_S:
            self.release("loss of control" if self._lost_s > self._sink_s else "critical sink rate")
