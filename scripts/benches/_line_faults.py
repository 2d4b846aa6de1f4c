"""Every line of the reference autopilot, changed: how much of what that does to a flight does some rule see?

Mutation testing of the rules (Offutt et al. 1996; DeMillo, Lipton and Sayward 1978): one operator or number of one
function is changed (`_blind_faults.py`), and procedures of all rules that reach the function are flown with it, each by
itself, until a rule is broken. A change that moves no flight by more than `APART` is told as such: nobody could see it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import cache
from types import FrameType
from typing import Any, NamedTuple

import msgspec
import numpy as np
from _blind_faults import Site, planted

from saflite.campaign.presets.campaigns import template
from saflite.campaign.presets.policy_campaigns import ALL, policy_campaign
from saflite.conformance.flying import DEADLINE_S, opened
from saflite.conformance.procedures import ProcedureFlights
from saflite.contract.flight import Flight, FlightRecord, Trace
from saflite.contract.rng import derive
from saflite.contract.target import Session
from saflite.contract.test_case import TestCase, identity
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.scenarios import scenarios_of
from saflite.oracle.judge import judge
from saflite.oracle.policy import policies_for
from saflite.simulator_worker.registry import load_target

SEEDS, LONGEST_S = (1, 2), 120.0
MISSIONS = 40
APART = {"place_m": 2.0, "height_m": 1.5, "heading_deg": 25.0, "lean_deg": 12.0, "mode_s": 0.5, "armed_s": 0.5}
"""How far two flights may differ and still count as the same."""
STOPS = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)


class Known(NamedTuple):
    """A flight without any change: the functions it reaches, and its trace."""

    case: TestCase
    reached: frozenset[tuple[str, str]]
    trace: Trace


def known_flights() -> list[Known]:
    """Return the procedures of all rules, each flown by itself with two seeds and no twin, and drawn missions."""
    return [known_flight(case) for case in (*_cases(), *missions())]


def missions() -> Iterator[TestCase]:
    """Yield short missions near home as a search draws them, left to themselves."""
    campaign = policy_campaign(ALL, describe())
    assert campaign is not None
    usual = template(campaign)
    drawn_from = scenarios_of(usual.scenario, describe())
    for number in range(MISSIONS):
        scenario = drawn_from.mission(derive(1, "line mission", number))
        yield msgspec.structs.replace(usual, scenario=scenario, rng_seed=number)


def _cases() -> Iterator[TestCase]:
    flights = ProcedureFlights(describe())
    for _, procedures in sorted(flights.procedures.items()):
        for procedure in procedures:
            for seed in SEEDS:
                case = msgspec.structs.replace(flights.by_itself(procedure, seed), twin="")
                if case.scenario.time_limit_s <= LONGEST_S:
                    yield case


def known_flight(case: TestCase) -> Known:
    """Return a flight without any change, with what it reaches; it is flown twice."""
    reached: set[tuple[str, str]] = set()

    def told(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            reached.add((frame.f_code.co_filename, frame.f_code.co_qualname))

    with opened(load_target(case.target.name)) as session:
        trace = _fly(session, case).trace
        sys.setprofile(told)
        try:
            _fly(session, case)
        finally:
            sys.setprofile(None)
    assert trace is not None, "a procedure without a change is flown to its end"
    return Known(case, frozenset(reached), trace)


def _fly(session: Session, case: TestCase) -> FlightRecord:
    return session.fly(case, DEADLINE_S, lambda: False)


def line_name(site: Site) -> str:
    """Return a name that no two places share: one line may hold two of a kind."""
    return f"{site.name} ({site.node})"


def seen_in_lines(site: Site, flights: list[Known], most: int) -> dict[str, Any]:
    """Return which rules see a changed line in up to `most` flights that reach its function, and how far it moves them.

    The flights are drawn by the name of the place; the first in which a rule is broken is the last.
    """
    file = sys.modules[site.module].__file__
    reaching = [one for one in flights if (file, site.function) in one.reached]
    order = derive(1, "line fault", line_name(site)).permutation(len(reaching))
    row: dict[str, Any] = {"part": "lines", "fault": line_name(site), "reached_in": len(reaching)}
    moved: dict[str, float] = {}
    with opened(load_target("reference")) as session, planted([site]):
        for place in order[:most]:
            one = reaching[place]
            try:
                record = _fly(session, one.case)
            except STOPS as fault:  # no rule is needed to see an autopilot that stops
                return {**row, "moved": moved, "seen_by": [type(fault).__name__]}
            if record.trace is None:
                return {**row, "moved": moved, "seen_by": [record.ending]}
            apart = _apart(one.trace, record.trace)
            if all(apart[name] < least for name, least in APART.items()):
                continue
            moved = {name: max(value, moved.get(name, 0.0)) for name, value in apart.items()}
            broken = _broken(one.case, record)
            if broken:
                return {**row, "moved": moved, "seen_by": broken}
    return {**row, "moved": moved, "seen_by": []}


def _apart(one: Trace, two: Trace) -> dict[str, float]:
    both = min(one.samples, two.samples)

    def gap(name: str) -> Any:
        return np.abs(one.array(name)[:both] - two.array(name)[:both])

    turned = (one.array("yaw_deg")[:both] - two.array("yaw_deg")[:both] + 180.0) % 360.0 - 180.0
    found = {
        "place_m": np.hypot(gap("x_m"), gap("y_m")).max(),
        "height_m": gap("altitude_m").max(),
        "heading_deg": np.abs(turned).max(),
        "lean_deg": max(gap("roll_deg").max(), gap("pitch_deg").max()),
        "mode_s": np.count_nonzero(gap("mode")) * one.step_s,
        "armed_s": np.count_nonzero(gap("armed")) * one.step_s,
    }
    return {name: round(float(value), 2) for name, value in found.items()}


@cache
def _rules() -> tuple[str, ...]:
    return tuple(policies_for("reference"))


def _broken(case: TestCase, record: FlightRecord) -> list[str]:
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    verdicts = judge(case, flight, record.trace, _rules()).verdicts
    return sorted(verdict.policy for verdict in verdicts if verdict.outcome == "violated")
