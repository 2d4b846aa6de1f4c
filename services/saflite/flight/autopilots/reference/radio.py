"""The pilot's sticks: pulses in, -1..1 out; loss of the radio link."""

from __future__ import annotations

from saflite.flight.autopilots.reference.parameters import ParameterSet
from saflite.flight.autopilots.reference.vehicle import Vehicle

CENTRED = {1: 1500.0, 2: 1500.0, 3: 1500.0, 4: 1500.0}
LOST_THROTTLE_PWM = 900.0


class Radio:
    """Channels 1 roll, 2 pitch (below centre is forward), 3 throttle, 4 yaw."""

    def __init__(self, board: Vehicle, parameters: ParameterSet) -> None:
        self._board, self._parameters = board, parameters
        self.sent = dict(CENTRED)
        self.received = dict(CENTRED)
        self.present = True
        self.throttle_filtered = 1500.0
        self._changes, self._moved = -1, True

    def stick(self, channel: int, pwm: float) -> None:
        """The pilot moves a stick."""
        self.sent[channel] = pwm
        self._moved = True

    def tick(self) -> None:
        """Receive what was sent, unless the link is down."""
        p = self._parameters
        settled = self.throttle_filtered == self.received[3] and p.changes == self._changes
        if settled and not self._moved:
            return
        self._changes, self._moved = p.changes, False
        board, fail = self._board, p["SIM_RC_FAIL"]
        self.present = fail < 1.0
        if fail < 1.0:
            self.received = dict(self.sent)
        elif fail >= 2.0:
            self.received = {**CENTRED, 3: LOST_THROTTLE_PWM}
        for channel in (1, 2, 3, 4):
            board[f"rc{channel}_pwm"] = self.received[channel]
        board["rc_present"] = 1.0 if self.present else 0.0
        cut_hz = p["PILOT_THR_FILT"]
        share = 1.0 if cut_hz <= 0.0 else min(1.0, 6.2832 * cut_hz * 0.02)
        self.throttle_filtered += share * (self.received[3] - self.throttle_filtered)

    def deflection(self, channel: int) -> float:
        """Return -1..1 of a stick, 0 within its dead zone, and while the link is down."""
        if not self.present:
            return 0.0
        p, pwm = self._parameters, self.received[channel]
        trim, dead = p[f"RC{channel}_TRIM"], p[f"RC{channel}_DZ"]
        if abs(pwm - trim) <= dead:
            return 0.0
        end = p[f"RC{channel}_MAX"] if pwm > trim else p[f"RC{channel}_MIN"]
        span = max(1.0, abs(end - trim) - dead)
        size = min(1.0, (abs(pwm - trim) - dead) / span)
        return size if pwm > trim else -size

    def throttle(self) -> float:
        """Return the throttle stick as 0..1."""
        p = self._parameters
        span = p["RC3_MAX"] - p["RC3_MIN"]
        return min(1.0, max(0.0, (self.throttle_filtered - p["RC3_MIN"]) / span))

    def throttle_high(self) -> bool:
        """Return whether the throttle stick is well above its lowest place."""
        return self.throttle() > 0.15

    def climb_mps(self) -> float:
        """Return the climb rate the throttle stick asks for: none within THR_DZ of the middle."""
        p = self._parameters
        if not self.present:
            return 0.0
        middle = 0.5 * (p["RC3_MIN"] + p["RC3_MAX"])
        offset, dead = self.throttle_filtered - middle, p["THR_DZ"]
        if abs(offset) <= dead:
            return 0.0
        size = min(1.0, (abs(offset) - dead) / max(1.0, 0.5 * (p["RC3_MAX"] - p["RC3_MIN"]) - dead))
        if offset > 0.0:
            return size * p["PILOT_SPEED_UP"] / 100.0
        return -size * (p["PILOT_SPEED_DN"] or p["PILOT_SPEED_UP"]) / 100.0
