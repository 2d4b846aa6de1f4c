"""One flight of the reference vehicle: world, vehicle, autopilot and the test case's inputs, tick by tick.

Time runs from the start of the trace. A mission begins standing on the ground, is armed after `READY_S` and ends when
the vehicle is disarmed again; a start state begins settled in its mode and ends at the time limit.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

from saflite.contract.errors import Unavailable
from saflite.contract.flight import Ending, FlightRecord, Trace, TraceMessage
from saflite.contract.service import Cancelled
from saflite.contract.signals import SIGNALS
from saflite.contract.test_case import StartState, TestCase
from saflite.flight.autopilots.reference import stimuli
from saflite.flight.autopilots.reference.autopilot import TICK_S, Autopilot
from saflite.flight.autopilots.reference.avoidance import Avoidance
from saflite.flight.autopilots.reference.defects import planted_in
from saflite.flight.autopilots.reference.vehicle import Vehicle
from saflite.flight.geometry import boxes_array
from saflite.flight.mission import MISSION_YAW_DEG
from saflite.flight.world.state import CRASHED, FLYING, FROZEN, STANDING, STEP_S
from saflite.flight.world.wind import WindField

STEPS_PER_TICK = round(TICK_S / STEP_S)
READY_S = 19.5  # from log start to take-off on the real vehicle
SETTLE_S = 5.0
GROUND_THROTTLE_PWM, MID_THROTTLE_PWM = 1000.0, 1500.0
TRACE_STEP_S = 0.05
TRACE_STEP_FINE_S = 0.02
AFTER_S = 2.0  # recorded after the end
CHUTE_AREA_M2 = 0.9  # sinks this vehicle at 5 m/s
ORACLE_MADE = {"time_s"}


class ReferenceFlight:
    """A flight from start to end; `run` flies it.

    Raises:
        Unavailable: JSBSim cannot be brought up.
        Refused: the test case asks for what this target does not have.
    """

    files: frozenset[int] = frozenset()  # that a fork of it needs

    def __init__(self, test_case: TestCase) -> None:
        scenario = test_case.scenario
        self.test_case, self.scenario = test_case, scenario
        self.start = scenario.start or StartState()
        on_ground = scenario.mission is not None or self.start.altitude_m <= 0.0
        altitude_m = 0.0 if on_ground else self.start.altitude_m
        yaw_deg = (test_case.heading_deg + (MISSION_YAW_DEG if scenario.mission else 0.0)) % 360.0
        self.boxes = boxes_array(scenario.obstacles)
        self.vehicle = Vehicle(test_case.rng_seed, self.boxes, altitude_m, yaw_deg)
        self.world = self.vehicle.world
        self.wind = WindField(scenario.wind, test_case.rng_seed)
        self.autopilot = Autopilot(self.vehicle, planted_in(test_case.target))
        self.inputs = stimuli.Player(self.autopilot, test_case.stimuli, trace_names())
        self.ticks = 0
        self.trace_start_s = 0.0
        self._chute_open = False
        self._wind_seen = -1
        self._ended_s: float | None = None
        self._over_s = -1.0  # the last moment at which nothing but stimuli to come kept the flight from its end

    # -- the whole flight -----------------------------------------------------------------------------------------

    def run(self, cancelled: Cancelled) -> FlightRecord:
        """Fly to the end and return the record; raises Unavailable when cancelled."""
        self.begin()
        return self._rest(cancelled)

    def begin(self) -> None:
        """Reach the start state and start the trace."""
        self.bring_up()
        self.vehicle.record(trace_names(), int(self.scenario.time_limit_s / self.trace_step_s) + 2, self.trace_step_s)

    @property
    def trace_step_s(self) -> float:
        """Time between two samples."""
        return TRACE_STEP_FINE_S if self.scenario.mission is None else TRACE_STEP_S

    @property
    def time_s(self) -> float:
        """Time since the start of the trace."""
        return self.ticks * TICK_S - self.trace_start_s

    def forking(self) -> AbstractContextManager[None]:
        """Return what a fork is made in: no other process belongs to the flight."""
        return nullcontext()

    def take_up(self) -> None:
        """Take up nothing: see `forking`."""

    def fly_to(self, test_case: TestCase, at_s: float, cancelled: Cancelled) -> bool:
        """Fly a test case with the same past until just before what is due at `at_s`, whether there is any or not.

        Returns:
            False if the flight ends before.

        Raises:
            Unavailable: it was cancelled.
        """
        self._follow(test_case)
        while round(self.time_s, 6) < at_s - 1e-9:
            ending = self._step(cancelled)
            if ending not in (None, "completed") or self.time_s >= self.scenario.time_limit_s - 1e-9:
                return False
        return True

    def fly_on(self, test_case: TestCase, cancelled: Cancelled) -> FlightRecord | None:
        """Fly a test case with the same past to its end; None if that flight had ended before this moment.

        Raises:
            Unavailable: it was cancelled.
        """
        self._follow(test_case)
        if self.inputs.finished and self._over_s >= self.inputs.last_s:
            return None
        self._ended_s = None
        return self._rest(cancelled)

    def _follow(self, test_case: TestCase) -> None:
        self.inputs.replace(test_case.stimuli)
        self.test_case = test_case

    def _rest(self, cancelled: Cancelled) -> FlightRecord:
        ending: Ending | None = None
        while ending is None:
            ending = self._step(cancelled)
        messages = tuple(message for message in self.autopilot.messages if message.at_s >= 0.0)
        trace = Trace(step_s=self.trace_step_s, signals=self.vehicle.columns(), messages=messages)
        return FlightRecord(ending, trace, self._last_word(), tuple(self.inputs.delivered))

    def _step(self, cancelled: Cancelled) -> Ending | None:
        if self.ticks % 50 == 0 and cancelled():
            raise Unavailable("flight cancelled")
        try:
            self.tick()
        except ArithmeticError as fault:  # of the stack under test, as its own processor would raise it
            self.autopilot.say(f"arithmetic exception: {fault}", "error")
            return "autopilot_died"
        return self._ending(self.scenario.time_limit_s)

    def tick(self) -> None:
        """One step of 20 ms: inputs, autopilot, weather, physics."""
        time_s = round(self.time_s, 6)
        self.autopilot.time_s = time_s
        self.inputs.tick(time_s)
        self.autopilot.tick(time_s)
        self._weather()
        board = self.vehicle
        if board["world_state"] == STANDING and board["motors_on"] > 0.0:
            board["world_state"] = FLYING
        board.run(STEPS_PER_TICK)
        self.ticks += 1

    def close(self) -> None:
        """Nothing was started that would have to end."""

    # -- start ----------------------------------------------------------------------------------------------------

    def bring_up(self) -> None:
        """Align the sensors, set the parameters, reach the start state."""
        board, autopilot = self.vehicle, self.autopilot
        stimuli.set_parameters(autopilot, self.test_case.target.parameters)
        autopilot.parameters.start()
        if self.scenario.mission is None and self.start.altitude_m > 0.0:
            self._start_in_the_air()
            return
        board.align()
        autopilot.set_home(0.0, 0.0, 0.0)
        autopilot.mission = self.scenario.mission
        if self.scenario.mission is None:
            self._start_on_the_ground()
            return
        autopilot.avoidance = self._avoidance()
        self.inputs.at(READY_S, self._begin_mission)

    def _avoidance(self) -> Avoidance | None:
        if self.autopilot.parameters["OA_TYPE"] == 0.0:
            return None
        return Avoidance(self.vehicle, self.boxes)

    def _begin_mission(self) -> None:
        autopilot = self.autopilot
        if not autopilot.set_mode("AUTO", "mission"):
            autopilot.arm()

    def _start_on_the_ground(self) -> None:
        self.autopilot.radio.stick(3, GROUND_THROTTLE_PWM)
        self._settle(SETTLE_S)
        self.autopilot.set_mode(self.start.mode, "start")
        if self.autopilot.mode.autonomous:
            self.autopilot.radio.stick(3, MID_THROTTLE_PWM)
        if self.start.armed:
            self.autopilot.arm(force=True)

    def _start_in_the_air(self) -> None:
        board, autopilot = self.vehicle, self.autopilot
        self.world.spin_up(0.47, 80)
        board.align()
        autopilot.armed, autopilot.landed, autopilot.taken_off = True, False, True
        autopilot.set_home(0.0, 0.0, 0.0)
        board["motors_on"] = 2.0
        board["reset_loops"] = 1.0
        autopilot.set_mode("GUIDED", "start")
        autopilot.mode.go_to(0.0, 0.0, self.start.altitude_m)  # type: ignore[attr-defined]
        self._settle(SETTLE_S)
        autopilot.set_mode(self.start.mode, "start")
        if not self.start.armed:
            autopilot.disarm("start")

    def _settle(self, seconds: float) -> None:
        """Fly (or stand) before the trace begins."""
        self.trace_start_s = seconds
        while self.ticks * TICK_S < seconds - 1e-9:
            self.tick()

    # -- during ---------------------------------------------------------------------------------------------------

    def _weather(self) -> None:
        if self._wind_seen != self.autopilot.parameters.changes:
            self._wind_seen = self.autopilot.parameters.changes
            self._change_wind()
        if not self.wind.still:
            self.world.set_wind(*self.wind.tick())
        if not self._chute_open and self.autopilot.parachute.open_now():
            self._chute_open = True
            self.world.set_drag_area(CHUTE_AREA_M2)

    def _change_wind(self) -> None:
        """Let it blow as the parameters say; where they say nothing (any more), as the scenario does."""
        p, own = self.autopilot.parameters, self.scenario.wind
        blows = (own.mean_mps, own.from_deg, own.gust_mps)
        if p["SIM_WIND_SPD"] > 0.0 or p["SIM_WIND_TURB"] > 0.0:
            blows = (p["SIM_WIND_SPD"], p["SIM_WIND_DIR"], p["SIM_WIND_TURB"])
        self.wind.change(*blows)

    def _ending(self, limit_s: float) -> Ending | None:
        time_s = self.time_s
        state = self.vehicle["world_state"]
        if state == CRASHED:
            return "crashed"
        over = self._is_over(state)
        if over:
            self._over_s = time_s
        if not over or not self.inputs.finished:
            self._ended_s = None
        elif self._ended_s is None:
            self._ended_s = time_s
        if self._ended_s is not None and time_s - self._ended_s >= AFTER_S:
            return "completed"
        if time_s >= limit_s - 1e-9:
            return "timed_out" if self.scenario.mission is not None else "completed"
        return None

    def _is_over(self, state: float) -> bool:
        """Back on the ground with motors off, or stopped under the parachute."""
        autopilot = self.autopilot
        down = autopilot.landed and not autopilot.armed and autopilot.taken_off
        return state == FROZEN or down

    def _last_word(self) -> str:
        return next((m.text for m in reversed(self.autopilot.messages) if m.severity == "error"), "")


def trace_names() -> tuple[str, ...]:
    """Return the signals of contract/signals.py that this target writes."""
    return tuple(name for name in SIGNALS if name in Vehicle.slots() and name not in ORACLE_MADE)


def note(at_s: float, text: str) -> TraceMessage:
    """Return a message of the world."""
    return TraceMessage(at_s=at_s, text=text)
