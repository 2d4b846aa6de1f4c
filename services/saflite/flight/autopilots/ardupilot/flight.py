"""One flight with ArduPilot; it repeats bit by bit."""

from __future__ import annotations

from saflite.contract.errors import Unavailable
from saflite.contract.rng import derive
from saflite.contract.test_case import Stimulus, TestCase
from saflite.flight.autopilots.ardupilot.binary import tells_ekf
from saflite.flight.autopilots.ardupilot.bring_up import HEARTBEAT_S, Aircraft
from saflite.flight.autopilots.ardupilot.inputs import MODE_NUMBERS
from saflite.flight.autopilots.ardupilot.mission import as_taken
from saflite.flight.autopilots.ardupilot.own_truth import OWN_RATES_HZ, OwnTruth
from saflite.flight.autopilots.ardupilot.settings import own_physics, start_parameters, without_log
from saflite.flight.autopilots.ardupilot.signals import trace_names
from saflite.flight.autopilots.ardupilot.telemetry import MODES, RATES_HZ, Telemetry
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.flight import ANSWER_S, ExternalFlight
from saflite.flight.autopilots.external.inputs import Inputs
from saflite.flight.autopilots.external.link import CENTRE_US, TICK_S
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import Place
from saflite.flight.mission import places_of

READY_S = 120.0  # simulated
NOISE_TICKS = 50  # the vehicle waits up to a second longer, drawn anew for every random seed
NEAR_M = 0.5
ARM, TAKEOFF, START_MISSION = 400, 22, 300
ARMABLE = "STABILIZE"  # a mode in which every build may be armed
WIND = ("SIM_WIND_SPD", "SIM_WIND_DIR", "SIM_WIND_TURB")
WIND_MAX_MPS = 30.0
HEIGHT_AT = 6  # among the numbers of MAV_CMD_NAV_TAKEOFF


class ArduPilotFlight(ExternalFlight):
    """A flight; `run` flies it."""

    LOG = "dataflash.bin"

    def __init__(self, test_case: TestCase, binary: Binary, listing: Listing, place: Place) -> None:
        super().__init__(test_case, binary, listing, place, trace_names())
        self._own_physics = own_physics(test_case)
        self._rates_hz = OWN_RATES_HZ if self._own_physics else RATES_HZ
        self._changes_seen = -1
        self._wind_told = tuple(listing.values.get(name, 0.0) for name in WIND)

    def _powered_up(self) -> Aircraft:
        given = self.test_case.target.parameters
        known, own = self._listing.parameters, self._own_physics
        boxes, log = bool(len(self._boxes)), not without_log(self.test_case)
        parameters = start_parameters(given, known, obstacles=boxes, own_physics=own, log=log)
        self._parameters = {**self._listing.values, **parameters}
        return Aircraft(
            self._binary,
            self._place,
            parameters,
            self._boxes,
            home=self._home,
            yaw_deg=self._yaw_deg,
            before_tick=self._before_tick,
            own_physics=own,
        )

    def _change_weather(self) -> None:
        """Let our world's wind be what the binary's own wind parameters say, once one of them is changed."""
        told = self._telemetry
        if self._own_physics or told.changes == self._changes_seen:
            return
        self._changes_seen = told.changes
        wind = tuple(told.parameters.get(name, 0.0) for name in WIND)
        if wind != self._wind_told:
            self._wind_told = wind
            self._wind.change(min(max(wind[0], 0.0), WIND_MAX_MPS), wind[1], min(max(wind[2], 0.0), WIND_MAX_MPS))

    def _greet(self, aircraft: Aircraft) -> None:
        made = OwnTruth if self._own_physics else Telemetry
        self._telemetry = made(aircraft.vehicle, self._parameters, self._home)
        self._telemetry.tells_ekf = tells_ekf(self._binary)
        pulses_us, stimuli = aircraft.pulses_us, self.test_case.stimuli
        self._inputs = Inputs(aircraft.client, pulses_us, stimuli, self._listing, MODE_NUMBERS)
        self._inputs.on_accepted = lambda stimulus: _note_takeoff(aircraft, stimulus)
        if not aircraft.client.wait_for_heartbeat(HEARTBEAT_S):
            raise Unavailable(f"{self._version}: no heartbeat within {HEARTBEAT_S:.0f} simulated s")
        self._ask_for(aircraft, {name: RATES_HZ[name] for name in ("SYS_STATUS", "EKF_STATUS_REPORT")})

    def _reach_start(self, aircraft: Aircraft) -> str:
        why = self._get_ready(aircraft)
        self._ask_for(aircraft, self._rates_hz)
        why = why or self._lift_off(aircraft)
        if not why and isinstance(self._telemetry, OwnTruth) and not self._telemetry.told:
            why = "this build does not say where its own physics has the vehicle (SIM_STATE): physics = jsbsim"
        return why

    def _get_ready(self, aircraft: Aircraft) -> str:
        """Wait for the estimate and the checks before arming; return why not."""
        if not self._wait(aircraft, lambda: self._telemetry.ready, READY_S):
            return f"not ready within {READY_S:.0f} s: {self._last_words()}"
        longer_s = TICK_S * float(derive(self.test_case.rng_seed, "ardupilot", "start").integers(NOISE_TICKS))
        self._wait(aircraft, lambda: False, longer_s)
        if self._mission is not None:
            return self._upload(aircraft, as_taken(self._mission), home=True)
        return ""

    def _lift_off(self, aircraft: Aircraft) -> str:
        """Arm and reach the height and mode of the start state, or start the mission; return why not."""
        client, start = aircraft.client, self.start
        if self._mission is None and not start.armed:
            return self._enter(aircraft, start.mode)
        flies = self._mission is not None or start.altitude_m > 0.0
        why = self._enter(aircraft, "GUIDED" if flies else start.mode)
        if not why and (why := self._armed(aircraft)) and not flies:
            # a mode in which nobody may arm (BRAKE, RTL) is entered with the motors on
            why = self._enter(aircraft, ARMABLE) or self._armed(aircraft) or self._enter(aircraft, start.mode)
        if why:
            return why
        if self._mission is not None:
            aircraft.pulses_us[2] = CENTRE_US
            heights_m = [place.z_m for place in places_of(self._mission) if place.kind == "takeoff"]
            aircraft.vehicle["takeoff_altitude_set_m"] = next(iter(heights_m), 0.0)
            return "" if client.command(START_MISSION, (0.0, 0.0), ANSWER_S).ok else "the mission did not start"
        return self._climb(aircraft) if flies else ""

    def _armed(self, aircraft: Aircraft) -> str:
        return "" if aircraft.client.command(ARM, (1.0,), ANSWER_S).ok else f"did not arm: {self._last_words()}"

    def _climb(self, aircraft: Aircraft) -> str:
        height_m = self.start.altitude_m
        if not aircraft.client.command(TAKEOFF, (0, 0, 0, 0, 0, 0, height_m), ANSWER_S).ok:
            return f"did not take off: {self._last_words()}"
        aircraft.vehicle["takeoff_altitude_set_m"] = height_m
        return self._reach_height(aircraft, NEAR_M) or self._enter(aircraft, self.start.mode)

    def _enter(self, aircraft: Aircraft, mode: str) -> str:
        answer = aircraft.client.set_mode(MODES[mode], ANSWER_S)
        return "" if answer.ok else f"mode {mode} was {answer.state}: {self._last_words()}"


def _note_takeoff(aircraft: Aircraft, stimulus: Stimulus) -> None:
    """Show the height of a take-off that was taken: the vehicle does not tell it."""
    if stimulus.kind == "command" and stimulus.name.endswith("NAV_TAKEOFF") and len(stimulus.values) > HEIGHT_AT:
        aircraft.vehicle["takeoff_altitude_set_m"] = stimulus.values[HEIGHT_AT]
