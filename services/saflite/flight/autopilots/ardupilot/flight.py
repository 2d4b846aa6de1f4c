"""One flight with ArduPilot: powered up, flown to the start state, then given the test case's inputs.

Time runs from the start state. Between two ticks of 20 ms the autopilot waits for the world, so every message reaches
it at one moment of simulated time and a flight repeats bit by bit.
"""

from __future__ import annotations

from typing import Any

from saflite.contract.errors import Unavailable
from saflite.contract.flight import Ending, FlightRecord, Trace, TraceMessage
from saflite.contract.rng import derive
from saflite.contract.service import Cancelled
from saflite.contract.test_case import StartState, TestCase
from saflite.flight.autopilots.ardupilot import obstacles
from saflite.flight.autopilots.ardupilot.binary import Binary
from saflite.flight.autopilots.ardupilot.bring_up import HEARTBEAT_S, HOME, Aircraft, FailedBringUp, Place, one_core
from saflite.flight.autopilots.ardupilot.inputs import Inputs
from saflite.flight.autopilots.ardupilot.link import CENTRE_US, CRASHED_BEFORE, TICK_S, Stopped
from saflite.flight.autopilots.ardupilot.listing import Listing
from saflite.flight.autopilots.ardupilot.mission import as_taken
from saflite.flight.autopilots.ardupilot.settings import start_parameters
from saflite.flight.autopilots.ardupilot.signals import trace_names
from saflite.flight.autopilots.ardupilot.telemetry import MODES, RATES_HZ, Telemetry
from saflite.flight.autopilots.ardupilot.vehicle import GONE, SILENT
from saflite.flight.geometry import boxes_array
from saflite.flight.world.state import CRASHED
from saflite.flight.world.wind import WindField

TRACE_STEP_S = 0.04
READY_S, ANSWER_S, CLIMB_S, SETTLE_S = 120.0, 5.0, 60.0, 4.0  # simulated
AFTER_S = 2.0  # recorded after the end
NOISE_TICKS = 50  # the vehicle waits up to a second longer, drawn anew for every random seed
MISSION_YAW_DEG = 90.0
NEAR_M, SLOW_MPS = 0.5, 0.3
ARM, TAKEOFF, START_MISSION, SET_INTERVAL = 400, 22, 300, 511
CHECK_EVERY = 50
DEFAULT_START = StartState()
WIND = ("SIM_WIND_SPD", "SIM_WIND_DIR", "SIM_WIND_TURB")
WIND_MAX_MPS = 30.0


class ArduPilotFlight:
    """A flight; `run` flies it.

    Raises:
        Unavailable: JSBSim or the autopilot cannot be brought up.
    """

    def __init__(self, test_case: TestCase, binary: Binary, listing: Listing, place: Place) -> None:
        self.test_case, self.scenario = test_case, test_case.scenario
        self.start = test_case.scenario.start or DEFAULT_START
        self._binary, self._listing, self._place = binary, listing, place
        self._mission = self.scenario.mission
        self._boxes = boxes_array(self.scenario.obstacles)
        self._wind = WindField(self.scenario.wind, test_case.rng_seed)
        self._ticks = self._calls = 0
        self._telemetry: Telemetry  # from the first word on
        self._aircraft: Aircraft | None = None
        self._ended_s: float | None = None
        self.note = ""
        self._changes_seen = -1
        self._wind_told = tuple(listing.values.get(name, 0.0) for name in WIND)

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
            return self._unstarted(str(fault))
        try:
            self._begin(aircraft)
        except Stopped as fault:
            aircraft.process.listen()
            record = self._unstarted(aircraft.trouble(fault.came), self._artefacts(aircraft))
            aircraft.close()
            return record
        except BaseException:
            aircraft.close()
            raise
        try:
            return self._rest(aircraft)
        finally:
            aircraft.close()

    def _powered_up(self) -> Aircraft:
        mission, given = self._mission, self.test_case.target.parameters
        home = HOME if mission is None else (mission.home_lat_deg, mission.home_lon_deg, mission.home_alt_m)
        self._home = home
        parameters = start_parameters(given, self._listing.parameters, obstacles=bool(len(self._boxes)))
        self._parameters = {**self._listing.values, **parameters}
        yaw_deg = MISSION_YAW_DEG if mission is not None else 0.0
        return Aircraft(
            self._binary.path, self._place, parameters, self._boxes, home, yaw_deg, before_tick=self._before_tick
        )

    def _unstarted(self, why: str, artefacts: tuple[tuple[str, bytes], ...] = ()) -> FlightRecord:
        """Return the record of a flight that never began: a death is a finding where the test case set parameters.

        Raises:
            Unavailable: it set none, so the test case is not to blame.
        """
        if not self.test_case.target.parameters:
            raise Unavailable(f"{self._binary.version} did not come up: {why}")
        return FlightRecord("autopilot_died", None, f"before the start: {why}", (), artefacts)

    def _rest(self, aircraft: Aircraft) -> FlightRecord:
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

    def _record(self, aircraft: Aircraft, ending: Ending, trouble: str) -> FlightRecord:
        said = [one for one in self._telemetry.texts if one.at_s >= 0.0]
        if self.note:
            said.insert(0, TraceMessage(at_s=0.0, text=f"start state not reached: {self.note}", severity="warning"))
        if trouble:
            said.append(TraceMessage(at_s=self.time_s, text=trouble, severity="error"))
        message = trouble or next((one.text for one in reversed(said) if one.severity == "error"), "")
        trace = Trace(step_s=TRACE_STEP_S, signals=aircraft.vehicle.columns(), messages=tuple(said))
        return FlightRecord(ending, trace, message, tuple(self._inputs.delivered), self._artefacts(aircraft))

    def _artefacts(self, aircraft: Aircraft) -> tuple[tuple[str, bytes], ...]:
        logs = list(aircraft.logs().values())
        kept = (("console.txt", aircraft.process.console.encode()),)
        return (*kept, ("dataflash.bin", logs[-1])) if logs else kept

    # -- time -----------------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Time since the start state."""
        return round(self._ticks * TICK_S, 6)

    def _step(self, aircraft: Aircraft) -> Ending | None:
        self._inputs.give_due(self.time_s)
        self._poll(aircraft)
        self._ticks += 1
        return self._ending(aircraft)

    def _poll(self, aircraft: Aircraft) -> None:
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
        self._change_wind()
        if not self._wind.still:
            aircraft.vehicle.world.set_wind(*self._wind.tick())
        if len(self._boxes) and self._calls % obstacles.EVERY_TICKS == 0:
            board = aircraft.vehicle
            here = (board["x_m"], board["y_m"], board["altitude_m"])
            obstacles.send(aircraft.client.mav, aircraft.clock.monotonic_s(), self._boxes, here, board["yaw_rad"])

    def _change_wind(self) -> None:
        """Let the wind be what the binary's own wind parameters say, once one of them is changed: the world is ours."""
        told = self._telemetry
        if told.changes == self._changes_seen:
            return
        self._changes_seen = told.changes
        wind = tuple(told.parameters.get(name, 0.0) for name in WIND)
        if wind != self._wind_told:
            self._wind_told = wind
            self._wind.change(min(max(wind[0], 0.0), WIND_MAX_MPS), wind[1], min(max(wind[2], 0.0), WIND_MAX_MPS))

    def _ending(self, aircraft: Aircraft) -> Ending | None:
        board, time_s = aircraft.vehicle, self.time_s
        if board["world_state"] == CRASHED:
            return "crashed"
        flew = self._mission is not None or self.start.armed
        over = flew and board["armed"] == 0.0 and board["landed"] != 0.0 and self._inputs.finished
        if not over:
            self._ended_s = None
        elif self._ended_s is None:
            self._ended_s = time_s
        if self._ended_s is not None and time_s - self._ended_s >= AFTER_S:
            return "completed"
        if time_s >= self.scenario.time_limit_s - 1e-9:
            return "timed_out" if self._mission is not None else "completed"
        return None

    # -- start ----------------------------------------------------------------------------------------------------

    def _begin(self, aircraft: Aircraft) -> None:
        """Reach the start state and start the trace; where it does not get there, the flight starts from where it is.

        Raises:
            Stopped: the autopilot does not go on.
            Unavailable: it does not get ready though it is set up as it should be.
        """
        client = aircraft.client
        self._telemetry = Telemetry(aircraft.vehicle, self._parameters, self._home)
        self._inputs = Inputs(client, aircraft.radio, self.test_case.stimuli, self._listing)
        if not client.wait_for_heartbeat(HEARTBEAT_S):
            raise Unavailable(f"{self._binary.version}: no heartbeat within {HEARTBEAT_S:.0f} simulated s")
        self._ask_for(aircraft, ("SYS_STATUS", "EKF_STATUS_REPORT"))
        self.note = self._get_ready(aircraft)
        self._ask_for(aircraft, tuple(RATES_HZ))
        try:
            self.note = self.note or self._lift_off(aircraft)
            if not self.note or self.test_case.target.parameters:
                self._settle(aircraft)
        except Stopped as fault:
            if fault.came != CRASHED_BEFORE:
                raise
            self.note = "crashed on the way"
        if self.note and not self.test_case.target.parameters:
            raise Unavailable(f"{self._binary.version}: {self.note}")
        self._start_trace(aircraft)

    def _ask_for(self, aircraft: Aircraft, names: tuple[str, ...]) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        for name in names:
            number = getattr(ardupilotmega, f"MAVLINK_MSG_ID_{name}")
            aircraft.client.command(SET_INTERVAL, (number, 1e6 / RATES_HZ[name]), ANSWER_S)

    def _wait(self, aircraft: Aircraft, good: Any, within_s: float) -> bool:
        """Poll until `good()`; return whether it came in time."""
        end_s = aircraft.clock.monotonic_s() + within_s
        while aircraft.clock.monotonic_s() < end_s:
            self._poll(aircraft)
            if good():
                return True
        return False

    def _get_ready(self, aircraft: Aircraft) -> str:
        """Wait for the estimate and the checks before arming; return why not."""
        if not self._wait(aircraft, lambda: self._telemetry.ready, READY_S):
            return f"not ready within {READY_S:.0f} s: {self._last_words()}"
        longer_s = TICK_S * float(derive(self.test_case.rng_seed, "ardupilot", "start").integers(NOISE_TICKS))
        self._wait(aircraft, lambda: False, longer_s)
        if self._mission is not None:
            answer = aircraft.client.upload(as_taken(self._mission), 20.0)
            if not answer.ok:
                return f"the mission was {answer.state}, result {answer.result}"
            aircraft.vehicle["mission_count"] = float(len(self._mission.items))
        return ""

    def _lift_off(self, aircraft: Aircraft) -> str:
        """Arm and reach the height and mode of the start state, or start the mission; return why not."""
        client, start = aircraft.client, self.start
        if self._mission is None and not start.armed:
            return self._enter(aircraft, start.mode)
        flies = self._mission is not None or start.altitude_m > 0.0
        why = self._enter(aircraft, "GUIDED" if flies else start.mode)
        if not why and not client.command(ARM, (1.0,), ANSWER_S).ok:
            why = f"did not arm: {self._last_words()}"
        if why:
            return why
        if self._mission is not None:
            aircraft.radio.pulses_us[2] = CENTRE_US
            return "" if client.command(START_MISSION, (0.0, 0.0), ANSWER_S).ok else "the mission did not start"
        return self._climb(aircraft) if flies else ""

    def _climb(self, aircraft: Aircraft) -> str:
        board, height_m = aircraft.vehicle, self.start.altitude_m
        if not aircraft.client.command(TAKEOFF, (0, 0, 0, 0, 0, 0, height_m), ANSWER_S).ok:
            return f"did not take off: {self._last_words()}"
        board["takeoff_altitude_set_m"] = height_m

        def there() -> bool:
            return abs(board["altitude_est_m"] - height_m) < NEAR_M and abs(board["climb_mps"]) < SLOW_MPS

        if not self._wait(aircraft, there, CLIMB_S):
            return f"at {board['altitude_m']:.1f} m after {CLIMB_S:.0f} s: {self._last_words()}"
        aircraft.radio.pulses_us[2] = CENTRE_US
        self._wait(aircraft, lambda: False, SETTLE_S)
        return self._enter(aircraft, self.start.mode)

    def _enter(self, aircraft: Aircraft, mode: str) -> str:
        answer = aircraft.client.set_mode(MODES[mode], ANSWER_S)
        return "" if answer.ok else f"mode {mode} was {answer.state}: {self._last_words()}"

    def _settle(self, aircraft: Aircraft) -> None:
        """Wait until every signal was told once, and for a moment at which the trace takes a sample."""
        self._wait(aircraft, lambda: False, 0.1 if self._mission is not None else 1.0)
        while round(aircraft.clock.monotonic_s() / TICK_S) % round(TRACE_STEP_S / TICK_S):
            self._poll(aircraft)

    def _start_trace(self, aircraft: Aircraft) -> None:
        self._telemetry.zero_s = aircraft.clock.monotonic_s()
        self._telemetry.texts.clear()
        limit = int(self.scenario.time_limit_s / TRACE_STEP_S) + 2
        aircraft.vehicle.record(trace_names(), limit, TRACE_STEP_S)

    def _last_words(self) -> str:
        said = self._aircraft.client.texts if self._aircraft is not None else ()
        return said[-1] if said else "it said nothing"
