"""From a flight's record to the signals that policies read: what the trace holds and what can be made of the rest.

Signals about stimuli (`quiet_s`, `gps_true`, ...) go by what was delivered, not by what was planned: a late stimulus
counts from when it was given, a denied or timed-out one not at all. Where a flight does not tell, the plan stands.

What holds at the sample of time t at which a stimulus is given (a target reads its inputs, goes on, then writes the
next sample):

* signals of state (`mode`, `armed`, settings) show what held just before it; what it did shows at the next sample;
* events (`rise`, `fall`) are seen at the first sample after them, with `prev` for what held just before;
* what is made of stimuli (`quiet_s`, `gps_true`, ...) counts it from the sample at t on, so before anything it causes.

Stimuli of one instant take effect in the order of the test case, before the autopilot goes on by itself; what held
between them is shown by moments of their own (`moments.py`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Flight, Trace, given
from saflite.contract.signals import MADE_FROM, can_show
from saflite.contract.test_case import Stimulus, StimulusKind, TestCase
from saflite.flight.geometry import boxes_array, distance_to_boxes
from saflite.oracle.moments import moments_of, samples_of

Array = NDArray[np.float32]
BATTERY_TIMER_S, BATTERY_TIMER_MAX_S = 10.0, 120.0  # ArduPilot's BATT_LOW_TIMER: default and limit
STIMULI: tuple[str, ...] = get_args(StimulusKind)
NEVER_S = 1e6
ESTIMATES = {"x_est_m": "x_m", "y_est_m": "y_m", "altitude_est_m": "altitude_m", "climb_est_mps": "climb_mps"}
"""Logs of real autopilots hold estimates only, so the estimate stands for the truth and the other way round."""

FAULTS = ("gps_true", "baro_true", "body_true", "sticks_true")
_HARMLESS = ("rc_", "radio", "batt", "para_", "speedup", "pin_mask")


_STICK_SETTING = re.compile(r"rc\d+_|rcmap_|thr_dz")
_FORCE = (21196.0, 2989.0)  # magic numbers with which MAVLink forces motors off or on


def stops_motors(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders the motors off without regard to flight."""
    if stimulus.kind != "command":
        return False
    values = (*stimulus.values, *(0.0,) * 7)
    if stimulus.name.endswith("DO_FLIGHTTERMINATION"):
        return values[0] > 0.5
    return stimulus.name.endswith("COMPONENT_ARM_DISARM") and values[0] < 0.5 and values[1] in _FORCE


def fault_of(stimulus: Stimulus) -> str:
    """Return which of FAULTS the stimulus ends, empty for none: by its name, `SIM_GPS_NOISE` as well as `gps_noise`.

    A fault counts for the rest of the flight, even if it is taken back: an estimator may never recover.
    """
    name = stimulus.name.lower()
    if stimulus.kind == "parameter" and _STICK_SETTING.match(name):
        return "sticks_true"
    if stimulus.kind != "sensor_fault" and not name.startswith("sim_"):
        return ""
    name = name.removeprefix("sim_")
    if name.startswith(("gps", "baro")):
        return f"{name.split('_')[0]}_true"
    return "" if name.startswith(_HARMLESS) else "body_true"


class FlightSignals:
    """The signals of one flight by name; those the oracle makes itself are made on demand.

    Args:
        test_case: what was flown.
        flight: how it went; its `delivered` tells what was given.
        trace: the samples.
        between: show what held between stimuli of one instant, too (`moments.py`); otherwise samples alone.
    """

    def __init__(self, test_case: TestCase, flight: Flight, trace: Trace, *, between: bool = False) -> None:
        self._test_case, self._flight, self._trace = test_case, flight, trace
        self.moments = moments_of(trace, flight.delivered) if between else samples_of(trace)
        self._given = tuple(one for one in given(test_case.stimuli, flight.delivered) if one.is_cause)
        self._made: dict[str, Array] = {}
        self.samples, self.step_s, self.written = len(self.moments.row), trace.step_s, frozenset(trace.signals)
        self._makers: dict[str, Callable[[], Any]] = {
            "time_s": self._time,
            "quiet_s": lambda: self._quiet(STIMULI),
            "order_quiet_s": lambda: self._quiet(("command", "mode", "stick")),
            "command_quiet_s": lambda: self._quiet(("command",), never_s=-NEVER_S),
            **{name: partial(self._true, name) for name in FAULTS},
            "crashed": self._crashed,
            "stop_ordered": self._stop_ordered,
            "ground_speed_mps": lambda: np.hypot(self["vx_mps"], self["vy_mps"]),
            "home_distance_m": lambda: np.hypot(self["x_m"], self["y_m"]),
            "battery_timer_set_s": self._battery_timer,
            "tilt_deg": self._tilt,
            **{name: partial(self.__getitem__, true) for name, true in ESTIMATES.items()},
            "obstacle_distance_m": self._obstacle_distance,
        }
        assert self._makers.keys() == MADE_FROM.keys(), "the table of what is made does not name its makers"

    def __contains__(self, name: str) -> bool:
        return can_show(name, self.written)

    def __getitem__(self, name: str) -> Array:
        """Return one signal, shape (moments,); raises Refused if the trace cannot give it."""
        if name in self._made:
            return self._made[name]
        if name in self._trace.signals or name not in self._makers:
            made = self.moments.held(name, self._trace.array(name)[: self._trace.samples])
        else:
            made = np.asarray(self._makers[name](), dtype=np.float32)
        self._made[name] = made
        return made

    def pick(self, names: frozenset[str]) -> dict[str, Array]:
        """Return those of `names` that the flight can give."""
        return {name: self[name] for name in sorted(names) if name in self}

    def points(self) -> NDArray[np.float64]:
        """Return the track, shape (samples, 3): x, y, altitude in metres."""
        return np.stack([self["x_m"], self["y_m"], self["altitude_m"]], axis=1).astype(np.float64)

    def _time(self) -> NDArray[np.float64]:
        return self.moments.time_s

    def _causes(self) -> list[Stimulus]:
        return [one.stimulus for one in self._given]

    def _quiet(self, kinds: tuple[str, ...], *, never_s: float = 0.0) -> NDArray[np.float64]:
        times = self._time()
        at = np.array([never_s, *(one.at_s for one in self._causes() if one.kind in kinds)])
        last = at[np.searchsorted(at, times + 1e-9, side="right") - 1]
        return np.asarray(times - last)

    def _true(self, flag: str) -> NDArray[np.float64]:
        first_s = min((one.at_s for one in self._causes() if fault_of(one) == flag), default=np.inf)
        return (self._time() < first_s).astype(np.float64)

    def _stop_ordered(self) -> NDArray[np.float64]:
        first_s = min((one.at_s for one in self._causes() if stops_motors(one)), default=np.inf)
        return (self._time() >= first_s - self.step_s).astype(np.float64)

    def _battery_timer(self) -> NDArray[np.float64]:
        """The parameter over time: as the target starts, then as stimuli change it.

        Where it is not known whether a value was taken, one out of range is held to be refused.
        """
        held = np.full(self.samples, self._test_case.target.parameters.get("BATT_LOW_TIMER", BATTERY_TIMER_S))
        for stimulus, answer, _ in self._given:
            if stimulus.name != "BATT_LOW_TIMER" or not stimulus.values:
                continue
            if answer != "unanswered" or 0 <= stimulus.values[0] <= BATTERY_TIMER_MAX_S:
                held[self._time() >= stimulus.at_s] = stimulus.values[0]
        return held

    def _crashed(self) -> Array:
        flags = np.zeros(self.samples, dtype=np.float32)
        if self._flight.ending == "crashed":
            flags[-1:] = 1.0
        return flags

    def _tilt(self) -> NDArray[np.float64]:
        upright = np.cos(np.radians(self["roll_deg"])) * np.cos(np.radians(self["pitch_deg"]))
        return np.asarray(np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))))

    def _obstacle_distance(self) -> NDArray[np.float64]:
        return distance_to_boxes(self.points(), boxes_array(self._test_case.scenario.obstacles))
