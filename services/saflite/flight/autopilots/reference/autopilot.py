"""The reference autopilot: state, modes, arming, and the 50 Hz tick that joins them.

The semantics follow ArduCopter. Each mode is one file in `modes/`; commands, failsafes, arming checks, parachute and
radio have a file each. Everything the policies look at is written to the vehicle's board and so ends in the trace.
"""

from __future__ import annotations

from collections.abc import Iterable

from saflite.contract.errors import Refused
from saflite.contract.flight import TraceMessage
from saflite.contract.signals import MODES
from saflite.flight.autopilots.reference import arming, failsafes, landed, settings
from saflite.flight.autopilots.reference.defects import unchecked_parameters
from saflite.flight.autopilots.reference.flight_stack import FlightStack
from saflite.flight.autopilots.reference.modes.base import Mode
from saflite.flight.autopilots.reference.modes.table import make_mode
from saflite.flight.autopilots.reference.parachute import Parachute
from saflite.flight.autopilots.reference.parameters import ParameterSet
from saflite.flight.autopilots.reference.radio import Radio
from saflite.flight.autopilots.reference.vehicle import Vehicle

TICK_S = 0.02
MESSAGES_MAX = 500


class Autopilot(FlightStack):
    """One vehicle's flight stack.

    Args:
        board: the vehicle's blackboard.
        defects: planted defects that are switched on (`defects.py`).
    """

    def __init__(self, board: Vehicle, defects: Iterable[str] = ()) -> None:
        self.board = board
        self.defects = frozenset(defects)
        self.parameters = ParameterSet(board.__setitem__, unchecked_parameters(self.defects))
        self.radio = Radio(board, self.parameters)
        self.parachute: Parachute = Parachute(self)
        self.failsafes: failsafes.Failsafes = failsafes.Failsafes(self)
        self.landing: landed.LandDetector = landed.LandDetector(self)
        self.messages: list[TraceMessage] = []
        self.time_s = 0.0
        self.armed = False
        self.landed = True
        self.taken_off = False
        self.mission = None
        self.mission_index = 0
        self.home = (0.0, 0.0, 0.0)
        self.avoidance = None
        self.yaw_order_rad = None
        self.speed_order_mps = None
        self.mode: Mode = make_mode("STABILIZE", self)
        self._settings_seen = -1
        self._reset_seen = (0.0, 0.0)
        board["mode"] = MODES["STABILIZE"]
        board["tilt_max"] = 0.5
        board["defect_height_gps"] = 1.0 if "height-from-gps" in self.defects else 0.0
        self.parameters.start()

    # -- what others ask of it ------------------------------------------------------------------------------------

    def say(self, text: str, severity: str = "info") -> None:
        """Send a status text."""
        if len(self.messages) < MESSAGES_MAX:
            level = severity if severity in ("warning", "error") else "info"
            self.messages.append(TraceMessage(at_s=round(self.time_s, 3), text=text, severity=level))  # type: ignore[arg-type]

    def set_mode(self, name: str, reason: str) -> str:
        """Change the mode; return why not, empty if it did."""
        if name == self.mode.name:
            return ""
        try:
            wanted = make_mode(name, self)
        except Refused as fault:
            return str(fault)
        why = wanted.why_not()
        if why:
            self.say(f"mode {name} refused: {why}", "warning")
            return why
        self.mode.leave()
        previous, self.mode = self.mode, wanted
        self.board["mode"] = MODES[name]
        self.board["circle_radius_m"] = 0.0
        self.board["circle_rate_dps"] = 0.0
        self.board["takeoff"] = 0.0
        wanted.enter(previous)
        if previous.manual_throttle:  # what loops had summed up before the pilot flew is stale (AC_PosControl)
            self.board["reset_loops"] = 1.0
        self.say(f"mode {name} ({reason})")
        return ""

    def arm(self, *, force: bool = False) -> str:
        """Arm the motors; return why not, empty if armed."""
        if self.armed:
            return ""
        why = "" if force else arming.why_not(self)
        if why:
            self.say(f"Arm: {why}", "error")
            return why
        self.armed, self.landed, self.taken_off = True, True, False
        self.landing.reset()
        self.set_home_here()
        self.board["motors_on"] = 1.0
        self.board["reset_loops"] = 1.0
        self.say("Arming motors")
        return ""

    def disarm(self, reason: str) -> None:
        """Stop the motors."""
        if self.armed:
            self.say(f"Disarming motors ({reason})")
        self.armed = False
        self.board["motors_on"] = 0.0
        self.mode.disarmed()

    def set_home_here(self) -> None:
        """Make the estimated place home; height counts from here."""
        board = self.board
        up = -board["est_d"]
        self.set_home(board["est_n"], board["est_e"], up)

    def set_home(self, north_m: float, east_m: float, up_m: float) -> None:
        """Move home; altitudes are measured from it."""
        self.home = (north_m, east_m, up_m)
        self.board.set(home_north=north_m, home_east=east_m, home_up=up_m)

    def lift(self) -> None:
        """Let the motors lift the vehicle: the order to leave the ground."""
        self.board["motors_on"] = 2.0

    # -- the tick -------------------------------------------------------------------------------------------------

    def tick(self, time_s: float) -> None:
        """Decide for the next 20 ms."""
        self.time_s = time_s
        self.radio.tick()
        self.failsafes.tick()
        self._follow_reset()
        self.mode.run()
        self.landing.tick()
        self.parachute.tick()
        self.publish()

    def _follow_reset(self) -> None:
        """Where the estimate was set anew, places held move with it: the vehicle must not chase them."""
        reset = (self.board["est_reset_n"], self.board["est_reset_e"])
        if reset != self._reset_seen:
            self.mode.shift(reset[0] - self._reset_seen[0], reset[1] - self._reset_seen[1])
            self._reset_seen = reset

    def publish(self) -> None:
        """Write to the board what policies look at and no control loop does."""
        board = self.board
        board["armed"] = 1.0 if self.armed else 0.0
        board["landed"] = 1.0 if self.landed else 0.0
        board["taken_off"] = 1.0 if self.taken_off else 0.0
        board["mission_item"] = self.mission_index
        board["altitude_source"] = board["height_from"]
        board["altitude_target_m"] = board["set_altitude"] if board["want_z"] == 2.0 else board["altitude_est_m"]
        if self._settings_seen != self.parameters.changes:
            self._settings_seen = self.parameters.changes
            settings.publish(self)
