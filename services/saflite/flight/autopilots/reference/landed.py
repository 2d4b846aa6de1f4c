"""Is the vehicle on the ground? From throttle, climb rate and acceleration, as ArduCopter's land detector."""

from __future__ import annotations

from saflite.flight.autopilots.reference.flight_stack import FlightStack

LANDED_AFTER_S = 1.0
TOUCHING_AFTER_S = 0.2  # ArduCopter: LAND_DETECTOR_MAYBE_TRIGGER_SEC
TICK_S = 0.02
CLEAR_M = 0.4  # who is carried as high as that flies, however slowly it went up
PUSHING = 0.3  # throttle, as a share of hover, above which something is carried; hover may be set twice too high


class LandDetector:
    """Sets `landed`; disarms a vehicle that stays on the ground (DISARM_DELAY)."""

    def __init__(self, ap: FlightStack) -> None:
        self._ap = ap
        self.reset()

    def reset(self) -> None:
        """Forget how long it has been quiet."""
        self._quiet_s = 0.0
        self._idle_s = 0.0

    @property
    def touching(self) -> bool:
        """Return whether the ground seems to carry the vehicle, before it counts as landed."""
        return self._quiet_s >= TOUCHING_AFTER_S

    def tick(self) -> None:
        """Look at the last 20 ms."""
        ap, board = self._ap, self._ap.board
        if not ap.armed:
            ap.landed = ap.landed or not ap.taken_off or board["world_state"] != 1.0
            return
        pushing = board["throttle"] > PUSHING * board["hover"]
        still = abs(board["climb_est_mps"]) < 0.35 and abs(board["est_az"]) < 2.0
        if board["motors_on"] > 1.0 and (pushing or not still):
            self._quiet_s = 0.0
            rising = pushing and (board["climb_est_mps"] > 0.2 or board["altitude_est_m"] > CLEAR_M)
            if ap.landed and rising:
                ap.landed, ap.taken_off = False, True
        else:
            self._quiet_s += TICK_S
            ap.landed = ap.landed or self._quiet_s >= LANDED_AFTER_S
        self._disarm_when_idle()

    def _disarm_when_idle(self) -> None:
        ap = self._ap
        delay_s = ap.parameters["DISARM_DELAY"]
        self._idle_s = self._idle_s + TICK_S if ap.landed and ap.mode.may_disarm() else 0.0
        if ap.landed and ap.mode.disarms_on_landing():
            ap.disarm("landed")
        elif delay_s > 0.0 and self._idle_s > delay_s:
            ap.disarm("idle on the ground")
