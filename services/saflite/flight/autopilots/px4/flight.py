"""One flight with PX4. It repeats bit by bit only where PX4 may run at real-time priority, and not always there."""

from __future__ import annotations

import math

from saflite.contract.errors import Unavailable
from saflite.contract.rng import derive
from saflite.contract.test_case import StartState, TestCase
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.flight import ANSWER_S, ExternalFlight
from saflite.flight.autopilots.external.link import CENTRE_US, TICK_S
from saflite.flight.autopilots.external.listing import HEARTBEAT_S, Listing
from saflite.flight.autopilots.external.place import Place
from saflite.flight.autopilots.px4 import modes
from saflite.flight.autopilots.px4.bring_up import Aircraft
from saflite.flight.autopilots.px4.companion import Companion
from saflite.flight.autopilots.px4.inputs import Inputs
from saflite.flight.autopilots.px4.legs import Legs
from saflite.flight.autopilots.px4.mission import as_taken
from saflite.flight.autopilots.px4.own_truth import OWN_RATES_HZ, OwnTruth
from saflite.flight.autopilots.px4.pilot import Pilot
from saflite.flight.autopilots.px4.settings import (
    PILOT,
    as_texts,
    companion_of,
    own_physics,
    start_parameters,
)
from saflite.flight.autopilots.px4.signals import trace_names
from saflite.flight.autopilots.px4.telemetry import RATES_HZ, Telemetry

READY_S = 60.0  # simulated
BEGIN_S, NOISE_TICKS = 15.0, 50  # arming at a time of its own, up to a second later: drawn anew for every random seed
NEAR_M = 0.7
ARM, TAKEOFF = 400, 22
DEFAULT_START = StartState(mode="BRAKE")


class Px4Flight(ExternalFlight):
    """A flight; `run` flies it."""

    LOG = "flight.ulg"

    def __init__(self, test_case: TestCase, binary: Binary, listing: Listing, place: Place) -> None:
        super().__init__(test_case, binary, listing, place, trace_names(listing.values))
        self.start = test_case.scenario.start or DEFAULT_START
        self._companion: Legs | None = None
        self._own_physics = own_physics(test_case)

    def _powered_up(self) -> Aircraft:
        given = self.test_case.target.parameters
        parameters = start_parameters(given, self._listing, obstacles=bool(len(self._boxes)))
        self._parameters = {**self._listing.values, **parameters}
        return Aircraft(
            self._binary,
            self._place,
            as_texts(parameters, self._listing.types),
            self._boxes,
            home=self._home,
            yaw_deg=self._yaw_deg,
            rng_seed=self.test_case.rng_seed,
            before_tick=self._before_tick,
            own_physics=self._own_physics,
        )

    def _assist(self, aircraft: Aircraft) -> None:
        if self._companion is not None:
            self._companion.tick(aircraft.clock.monotonic_s(), TICK_S)

    def _greet(self, aircraft: Aircraft) -> None:
        client = aircraft.client
        made, rates_hz = (OwnTruth, OWN_RATES_HZ) if self._own_physics else (Telemetry, RATES_HZ)
        self._telemetry = made(aircraft.vehicle, client, self._parameters, self._home)
        given, own = (aircraft.pulses_us, self.test_case.stimuli, self._listing), self._own_physics
        self._inputs = Inputs(aircraft.vehicle, client, *given, home_up_m=self._home[2], own_physics=own)
        self._inputs.on_accepted = self._telemetry.take_order
        if not client.wait_for_heartbeat(HEARTBEAT_S):
            raise Unavailable(f"{self._version}: no heartbeat within {HEARTBEAT_S:.0f} simulated s")
        self._ask_for(aircraft, rates_hz)
        if self._mission is not None and (who := companion_of(self.test_case)):
            led = (aircraft.vehicle, client)
            by_sticks = who == PILOT
            self._companion = (
                Pilot(self._mission, aircraft.pulses_us, *led)
                if by_sticks
                else Companion(self._mission, self._boxes, *led)
            )

    def _reach_start(self, aircraft: Aircraft) -> str:
        """Arm at a fixed time, once ready, and reach the start state; return why not."""
        if not self._wait(aircraft, lambda: self._telemetry.ready, READY_S):
            return f"not ready within {READY_S:.0f} s: {self._last_words()}"
        if self._mission is not None or (self.start.armed and self.start.altitude_m > 0.0):
            aircraft.pulses_us[2] = CENTRE_US  # now: a stick that moves later takes over from modes that fly themselves
        begin_s = BEGIN_S + TICK_S * float(derive(self.test_case.rng_seed, "px4", "start").integers(NOISE_TICKS))
        self._wait(aircraft, lambda: False, begin_s - aircraft.clock.monotonic_s())
        if self._mission is not None:
            return self._start_mission(aircraft)
        start, client = self.start, aircraft.client
        if not start.armed or start.altitude_m == 0.0:
            first = modes.arms_in(start.mode) if start.armed else start.mode
            why = self._enter(aircraft, first)
            if not why and start.armed and not client.command(ARM, (1.0,), ANSWER_S).ok:
                why = f"did not arm: {self._last_words()}"
            return why if why or first == start.mode else self._enter(aircraft, start.mode)
        return self._climb(aircraft)

    def _start_mission(self, aircraft: Aircraft) -> str:
        assert self._mission is not None
        client = aircraft.client
        aircraft.patient = True  # it gives up a transfer by its own clock, and stores items by the disk's
        why = self._upload(aircraft, as_taken(self._mission), home=False)
        aircraft.patient = False
        why = why or self._enter(aircraft, "AUTO")
        if not why and not client.command(ARM, (1.0,), ANSWER_S).ok:
            why = f"did not arm: {self._last_words()}"
        return why

    def _climb(self, aircraft: Aircraft) -> str:
        client, height_m = aircraft.client, self.start.altitude_m
        above_sea_m = self._home[2] + height_m  # the height ordered is above sea, not home
        numbers = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, above_sea_m)
        if not client.command(TAKEOFF, numbers, ANSWER_S).ok:
            return f"did not take off: {self._last_words()}"
        if not client.command(ARM, (1.0,), ANSWER_S).ok:
            return f"did not arm: {self._last_words()}"
        return self._reach_height(aircraft, NEAR_M) or self._enter(aircraft, self.start.mode)

    def _enter(self, aircraft: Aircraft, mode: str) -> str:
        mode = "BRAKE" if mode == "GUIDED" else mode  # PX4's own is offboard, which needs a companion
        answer = aircraft.client.set_mode(modes.custom(mode), ANSWER_S)
        return "" if answer.ok else f"mode {mode} was {answer.state}: {self._last_words()}"
