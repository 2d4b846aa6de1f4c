"""One flight with an autopilot in another process: powered up, flown to the start state, then given its inputs.

Time runs from the start state. Between two ticks of 20 ms the autopilot waits for the world, so every message reaches
it at one moment of simulated time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import Ending, FlightRecord, Trace, TraceMessage
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Mission, StartState, TestCase
from saflite.flight.autopilots.external import obstacles
from saflite.flight.autopilots.external.aircraft import HOME
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.inputs import Inputs
from saflite.flight.autopilots.external.link import CENTRE_US, CRASHED_BEFORE, TICK_S, Stopped
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import FailedBringUp, Place, one_core
from saflite.flight.autopilots.external.vehicle import GONE, SILENT
from saflite.flight.geometry import boxes_array
from saflite.flight.mission import MISSION_YAW_DEG, NAV_LAST
from saflite.flight.world.state import CRASHED
from saflite.flight.world.wind import WindField

TRACE_STEP_S = 0.04
AFTER_S = 2.0  # recorded after the end
ANSWER_S, CLIMB_S, SETTLE_S, UPLOAD_S = 5.0, 60.0, 4.0, 20.0  # simulated
RESULTS = {
    1: "error",
    2: "frame not supported",
    3: "command not supported",
    4: "no space",
    5: "invalid item",
    **{6 + place: f"parameter {place + 1} invalid" for place in range(7)},
    13: "out of sequence",
    14: "denied",
    15: "cancelled",
}
"""What MAV_MISSION_RESULT means."""
SLOW_MPS = 0.3
FALLING_MPS = 2.0
SET_INTERVAL = 511
CHECK_EVERY = 50
DEFAULT_START = StartState()


class ExternalFlight(ABC):
    """A flight; `run` flies it.

    Raises:
        Unavailable: JSBSim or the autopilot cannot be brought up.
        Refused: the autopilot does not take the mission.
    """

    LOG = ""
    """Name of the autopilot's own log among the artefacts."""

    def __init__(
        self, test_case: TestCase, binary: Binary, listing: Listing, place: Place, trace_names: tuple[str, ...]
    ) -> None:
        self._binary, self._listing, self._version, self._place = binary, listing, binary.version, place
        self._trace_names = trace_names
        self.test_case, self.scenario = test_case, test_case.scenario
        self.start = test_case.scenario.start or DEFAULT_START
        self._mission = mission = self.scenario.mission
        self._home = HOME if mission is None else (mission.home_lat_deg, mission.home_lon_deg, mission.home_alt_m)
        self._yaw_deg = (test_case.heading_deg + (MISSION_YAW_DEG if mission is not None else 0.0)) % 360.0
        self._boxes = boxes_array(self.scenario.obstacles)
        self._wind = WindField(self.scenario.wind, test_case.rng_seed)
        self._ticks = self._calls = 0
        self._telemetry: Any = None  # made in `_greet`, and so are the inputs
        self._inputs: Inputs
        self._aircraft: Any = None
        self._ended_s: float | None = None
        self._uploaded = False  # a mission, or a part of it
        self._over_s = -1.0  # the last moment at which nothing but stimuli to come kept the flight from its end
        self.note = ""

    @abstractmethod
    def _powered_up(self) -> Any:
        """Start the autopilot in its world; raises FailedBringUp or Unavailable."""

    @abstractmethod
    def _greet(self, aircraft: Any) -> None:
        """Make telemetry and inputs, and wait for the first word; raises Unavailable where none comes."""

    @abstractmethod
    def _reach_start(self, aircraft: Any) -> str:
        """Wait until it is ready and fly to the start state; return why it did not get there."""

    def _change_weather(self) -> None:  # noqa: B027  (PX4 has no wind of its own)
        """Take over what the autopilot's own simulation parameters say of the world."""

    def _assist(self, aircraft: Any) -> None:  # noqa: B027  (where nothing flies beside the autopilot)
        """Let what flies beside the autopilot act, if anything does."""

    # -- the whole flight -----------------------------------------------------------------------------------------

    def run(self, cancelled: Cancelled) -> FlightRecord:
        """Fly to the end and return the record; raises Unavailable when cancelled or where it does not come up."""
        self._cancelled = cancelled
        with one_core(self._place):
            return self._run()

    def _run(self) -> FlightRecord:
        try:
            aircraft = self._aircraft = self._powered_up()
        except FailedBringUp as fault:
            return self._unstarted(GONE, str(fault))
        try:
            self._begin(aircraft)
        except Stopped as fault:
            aircraft.process.listen()
            record = self._unstarted(fault.came, aircraft.trouble(fault.came), aircraft.artefacts(self.LOG))
            aircraft.close()
            return record
        except BaseException:
            aircraft.close()
            raise
        return self._rest(aircraft)

    def _unstarted(self, came: int, why: str, artefacts: tuple[tuple[str, bytes], ...] = ()) -> FlightRecord:
        """Return the record of a flight that never began: a finding where the test case set parameters or a mission.

        Raises:
            Unavailable: nothing of the test case had reached it, so that is not to blame.
        """
        if not (self.test_case.target.parameters or self._uploaded):
            raise Unavailable(f"{self._version} did not come up: {why}")
        ending: Ending = "wedged" if came == SILENT and self._uploaded else "autopilot_died"
        return FlightRecord(ending, None, f"before the start: {why}", (), artefacts)

    def _rest(self, aircraft: Any) -> FlightRecord:
        try:
            return self._flown(aircraft)
        finally:
            aircraft.close()

    def _flown(self, aircraft: Any) -> FlightRecord:
        ending: Ending | None = None
        trouble = ""
        try:
            ending = "crashed" if aircraft.vehicle["world_state"] == CRASHED else None
            while ending is None:
                ending = self._step(aircraft)
        except Stopped as fault:
            trouble = aircraft.trouble(fault.came)
            ending = "autopilot_died" if fault.came == GONE else "wedged" if fault.came == SILENT else "infra"
        return self._record(aircraft, ending, trouble)

    def _record(self, aircraft: Any, ending: Ending, trouble: str) -> FlightRecord:
        said = [one for one in self._telemetry.texts if one.at_s >= 0.0]
        if self.note:
            said.insert(0, TraceMessage(at_s=0.0, text=f"start state not reached: {self.note}", severity="warning"))
        if trouble:
            said.append(TraceMessage(at_s=self.time_s, text=trouble, severity="error"))
        message = trouble or next((one.text for one in reversed(said) if one.severity == "error"), "")
        trace = Trace(step_s=TRACE_STEP_S, signals=aircraft.vehicle.columns(), messages=tuple(said))
        return FlightRecord(ending, trace, message, tuple(self._inputs.delivered), aircraft.artefacts(self.LOG))

    # -- time -----------------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Time since the start state."""
        return round(self._ticks * TICK_S, 6)

    def _step(self, aircraft: Any) -> Ending | None:
        self._inputs.give_due(self.time_s)
        self._poll(aircraft)
        self._ticks += 1
        return self._ending(aircraft)

    def _poll(self, aircraft: Any) -> None:
        """Step a tick and take what was said in it."""
        now_s = aircraft.clock.monotonic_s()
        for message in aircraft.client.poll(TICK_S):
            self._take(message, now_s)
        self._telemetry.tick()

    def _take(self, message: Any, now_s: float) -> None:
        self._telemetry.take(message, now_s)
        self._inputs.hear(message)

    def _before_tick(self) -> None:
        """Weather and obstacles of the tick to come; looks from time to time whether to stop."""
        aircraft = self._aircraft
        self._calls += 1
        if self._calls % CHECK_EVERY == 0 and self._cancelled():
            raise Unavailable("flight cancelled")
        if aircraft is None:
            return
        self._change_weather()
        self._assist(aircraft)
        if not self._wind.still:
            aircraft.vehicle.world.set_wind(*self._wind.tick())
        if len(self._boxes) and self._calls % obstacles.EVERY_TICKS == 0:
            board = aircraft.vehicle
            here = (board["x_m"], board["y_m"], board["altitude_m"])
            obstacles.send(aircraft.client.mav, aircraft.clock.monotonic_s(), self._boxes, here, board["yaw_rad"])

    def _ending(self, aircraft: Any) -> Ending | None:
        board, time_s = aircraft.vehicle, self.time_s
        if board["world_state"] == CRASHED:
            return "crashed"
        flew = self._mission is not None or self.start.armed
        down = (
            board["landed"] != 0.0 and abs(board["climb_mps"]) < FALLING_MPS
        )  # disarmed in the air it says landed, too
        over = flew and board["armed"] == 0.0 and down
        if over:
            self._over_s = time_s
        if not over or not self._inputs.finished:
            self._ended_s = None
        elif self._ended_s is None:
            self._ended_s = time_s
        if self._ended_s is not None and time_s - self._ended_s >= AFTER_S:
            return "completed"
        if time_s >= self.scenario.time_limit_s - 1e-9:
            return "timed_out" if self._mission is not None else "completed"
        return None

    # -- start ----------------------------------------------------------------------------------------------------

    def _begin(self, aircraft: Any) -> None:
        """Reach the start state and start the trace; where it does not get there, the flight starts from where it is.

        Raises:
            Stopped: the autopilot does not go on.
            Unavailable: it does not get ready though it is set up as it should be.
        """
        self._greet(aircraft)
        try:
            self.note = self._reach_start(aircraft)
            if not self.note or self.test_case.target.parameters:
                self._settle(aircraft)
        except Stopped as fault:
            if fault.came != CRASHED_BEFORE:
                raise
            self.note = "crashed on the way"
        if self.note and not self.test_case.target.parameters:
            raise Unavailable(f"{self._version}: {self.note}")
        self._start_trace(aircraft)

    def _upload(self, aircraft: Any, mission: Mission, *, home: bool) -> str:
        """Give it the mission, with the home place before the items if `home`; return why it has none.

        Raises:
            Refused: it does not take it.
        """
        client = aircraft.client
        before = len(client.texts)
        self._uploaded = True
        answer = client.upload(mission, UPLOAD_S)
        if answer.state == "timed_out":
            return "the mission was not answered"
        if not answer.ok:
            at = "" if answer.item is None else f" at item {answer.item + (0 if home else 1)}"
            what = RESULTS.get(answer.result or 0, "refused")
            words = "".join(f"; it says {text}" for text in list(client.texts)[before:][-1:])
            got = f"{what} (MAV_MISSION_RESULT {answer.result}){at}{words}"
            expected = f"one that {self._version} takes"
            raise Refused("mission", where=mission.name, expected=expected, got=got, fix="change or drop that item")
        aircraft.vehicle["mission_count"] = float(_flown_items(mission))
        return ""

    def _ask_for(self, aircraft: Any, rates_hz: Mapping[str, float]) -> None:
        """Ask for messages at these rates."""
        from pymavlink.dialects.v20 import ardupilotmega

        for name, rate_hz in rates_hz.items():
            number = getattr(ardupilotmega, f"MAVLINK_MSG_ID_{name}")
            aircraft.client.command(SET_INTERVAL, (number, 1e6 / rate_hz), ANSWER_S)

    def _wait(self, aircraft: Any, good: Any, within_s: float) -> bool:
        """Poll until `good()`; return whether it came in time."""
        end_s = aircraft.clock.monotonic_s() + within_s
        while aircraft.clock.monotonic_s() < end_s:
            self._poll(aircraft)
            if good():
                return True
        return False

    def _reach_height(self, aircraft: Any, near_m: float) -> str:
        """Wait for the height of the start state, and some seconds more; return why it is not reached."""
        board, height_m = aircraft.vehicle, self.start.altitude_m

        def there() -> bool:
            return bool(abs(board["altitude_est_m"] - height_m) < near_m and abs(board["climb_mps"]) < SLOW_MPS)

        if not self._wait(aircraft, there, CLIMB_S):
            return f"at {board['altitude_m']:.1f} m after {CLIMB_S:.0f} s: {self._last_words()}"
        aircraft.pulses_us[2] = CENTRE_US
        self._wait(aircraft, lambda: False, SETTLE_S)
        return ""

    def _settle(self, aircraft: Any) -> None:
        """Wait until every signal was told once, and for a moment at which the trace takes a sample."""
        self._wait(aircraft, lambda: False, 0.1 if self._mission is not None else 1.0)
        while round(aircraft.clock.monotonic_s() / TICK_S) % round(TRACE_STEP_S / TICK_S):
            self._poll(aircraft)

    def _start_trace(self, aircraft: Any) -> None:
        self._telemetry.zero_s = aircraft.clock.monotonic_s()
        self._telemetry.texts.clear()
        limit = int(self.scenario.time_limit_s / TRACE_STEP_S) + 2
        aircraft.vehicle.record(self._trace_names, limit, TRACE_STEP_S)

    def _last_words(self) -> str:
        said = self._aircraft.client.texts if self._aircraft is not None else ()
        return said[-1] if said else "it said nothing"


def _flown_items(mission: Mission) -> int:
    """Return the number of items up to the last that flies somewhere: an autopilot hovers there, its mission done."""
    return max((number for number, item in enumerate(mission.items, start=1) if item.command <= NAV_LAST), default=0)
