"""What every target promises, as checks that code from outside can run on its own.

`check_repeatable_target` is for targets whose flights repeat bit by bit, `check_statistical_target` for those where
only the distribution of outcomes repeats. Flights are flown in this process; nothing of a campaign is needed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import partial
from typing import get_args

import msgspec

from saflite.conformance.flying import DEADLINE_S, opened
from saflite.conformance.kit import Check
from saflite.conformance.target_cases import default_cases, scenario
from saflite.contract import wire
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FLOWN_ENDINGS, DeliveryAnswer, FlightRecord
from saflite.contract.target import ForkingSession, Session, TargetModule
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase, cut_off
from saflite.simulator_worker import agreement
from saflite.simulator_worker.processes import children

Cases = Sequence[TestCase] | None
FLIGHTS = 5  # of one test case on a target that repeats statistically
CAN_BE_TAKEN: tuple[StimulusKind, ...] = ("parameter", "stick", "sensor_fault")
"""Kinds of which some value in range can be taken at any time; commands and modes may be out of place at a start."""
CUT_SHARE = 0.6  # of a whole flight: the smaller time limit under which it has to begin alike
SHARES = (0.0, 0.3, 0.7)  # of the time limit: where snapshots are taken


def checks_of(target: TargetModule, cases: Cases = None) -> tuple[Check, ...]:
    """Return the suite that fits what the target says of itself."""
    bitwise = target.describe().repeats == "bitwise"
    return check_repeatable_target(target, cases) if bitwise else check_statistical_target(target, cases)


def check_repeatable_target(target: TargetModule, cases: Cases = None) -> tuple[Check, ...]:
    """Return the checks of a target whose flights repeat bit by bit; `cases` instead of those made from `describe`."""
    return (
        Check("says_that_it_repeats_bit_by_bit", partial(_says, target, "bitwise")),
        *_common(target, cases),
        Check("repeats_bit_by_bit", partial(_repeats, target, cases)),
        Check("begins_alike_whatever_its_time_limit", partial(_begins_alike, target, cases)),
        Check("flies_on_from_snapshots_as_from_the_start", partial(_snapshots, target, cases)),
    )


def check_statistical_target(target: TargetModule, cases: Cases = None) -> tuple[Check, ...]:
    """Return the checks of a target where only the distribution of outcomes repeats."""
    return (
        Check("says_that_it_repeats_statistically", partial(_says, target, "statistically")),
        *_common(target, cases),
        Check("agrees_with_its_description_flight_after_flight", partial(_again_and_again, target, cases)),
    )


def _common(target: TargetModule, cases: Cases) -> tuple[Check, ...]:
    return (
        Check("describes_itself_without_contradiction", partial(_description, target)),
        Check("can_fly_here", partial(_present, target)),
        Check("takes_the_inputs_it_names", partial(_takes, target, cases)),
        Check("refuses_what_it_does_not_have", partial(_refuses, target)),
        Check("flies_as_it_describes", partial(_flies, target, cases)),
        Check("stops_when_cancelled_and_flies_on", partial(_cancels, target, cases)),
        Check("leaves_nothing_behind", partial(_leaves, target, cases)),
    )


# ---- what it says -------------------------------------------------------------------------------------------------


def _says(target: TargetModule, repeats: str) -> Iterator[str]:
    said = target.describe().repeats
    if said != repeats:
        yield f"describe().repeats is {said!r}, this suite is for {repeats!r}"


def _description(target: TargetModule) -> Iterator[str]:
    info = target.describe()
    yield from agreement.own_contradictions(info)
    if wire.unpack(msgspec.msgpack.encode(info), TargetInfo) != info:
        yield "describe() does not survive the way over the wire"
    if target.describe() != info:
        yield "describe() says something else each time"


def _present(target: TargetModule) -> Iterator[str]:
    missing = target.describe().missing
    if missing:
        yield missing


def _takes(target: TargetModule, cases: Cases) -> Iterator[str]:
    for case in cases or default_cases(target.describe()):
        try:
            target.check(case)
        except Refused as fault:
            yield str(fault)


def _refuses(target: TargetModule) -> Iterator[str]:
    for what, case in _not_there(target.describe()):
        try:
            target.check(case)
        except Refused:
            continue
        yield f"check() takes {what}"


def _not_there(info: TargetInfo) -> Iterator[tuple[str, TestCase]]:
    """Yield what no target has, in words and as a test case that asks for it."""
    good, mine = scenario(info), Target(name=info.name)
    long = msgspec.structs.replace(good, time_limit_s=2.0 * info.time_limit_max_s)
    nowhere = Scenario(start=StartState(mode="NO_SUCH_MODE"), time_limit_s=1.0)
    yield "a flight longer than time_limit_max_s", TestCase(target=mine, scenario=long)
    yield "a flight of no time", TestCase(target=mine, scenario=msgspec.structs.replace(good, time_limit_s=0.0))
    yield "a start in a mode it does not have", TestCase(target=mine, scenario=nowhere)
    for what, kept in (
        ("an unknown parameter", Target(name=info.name, parameters={"NO_SUCH": 1.0})),
        ("an unknown setting", Target(name=info.name, settings={"no such": 1.0})),
    ):
        yield what, TestCase(target=kept, scenario=good)
    for what, stimulus in _inputs_not_there(info):
        yield what, TestCase(target=mine, scenario=good, stimuli=(stimulus,))


def _inputs_not_there(info: TargetInfo) -> Iterator[tuple[str, Stimulus]]:
    """Yield inputs of no name it knows, before the start, or of another count of numbers than their kind has."""
    for kind in get_args(StimulusKind):
        values = () if kind == "mode" else (1500.0,)
        yield f"a {kind} it does not have", Stimulus(at_s=0.5, kind=kind, name="NO_SUCH", values=values)
    for one in {one.kind: one for one in info.inputs}.values():
        yield f"a {one.kind} before the start", Stimulus(at_s=-1.0, kind=one.kind, name=one.name)
        if one.kind != "command":
            crowd = Stimulus(at_s=0.5, kind=one.kind, name=one.name, values=(1.0, 2.0))
            yield f"two numbers for a {one.kind}", crowd


# ---- what it does -------------------------------------------------------------------------------------------------


def _flies(target: TargetModule, cases: Cases) -> Iterator[str]:
    info = target.describe()
    tried: set[tuple[StimulusKind, DeliveryAnswer]] = set()
    with opened(target) as session:
        for number, case in enumerate(cases or default_cases(info)):
            record = _fly(session, case)
            for wrong in agreement.contradictions(info, case, record):
                yield f"test case {number}: {wrong}"
            if record.ending not in FLOWN_ENDINGS:
                yield f"test case {number} ended as {record.ending}: {record.message}"
            tried.update(_answers(case, record))
    for kind in CAN_BE_TAKEN:
        answers = {answer for other, answer in tried if other == kind}
        if answers == {"denied"}:
            yield f"denied every {kind.replace('_', ' ')} that describe() names"


def _answers(case: TestCase, record: FlightRecord) -> Iterator[tuple[StimulusKind, DeliveryAnswer]]:
    for one in record.delivered or ():
        if 0 <= one.index < len(case.stimuli):
            yield case.stimuli[one.index].kind, one.answer


def _again_and_again(target: TargetModule, cases: Cases) -> Iterator[str]:
    info = target.describe()
    case = (cases or default_cases(info))[-1]
    with opened(target) as session:
        for number in range(FLIGHTS):
            for wrong in agreement.contradictions(info, case, _fly(session, case)):
                yield f"flight {number}: {wrong}"


def _repeats(target: TargetModule, cases: Cases) -> Iterator[str]:
    some = tuple(cases or default_cases(target.describe()))
    with opened(target) as session:
        first = [_fly(session, case) for case in some]
        for number, case in reversed(tuple(enumerate(some))):
            for wrong in agreement.differences(first[number], _fly(session, case)):
                yield f"test case {number}, again after others: {wrong}"
    with opened(target) as session:
        for wrong in agreement.differences(first[-1], _fly(session, some[-1])):
            yield f"test case {len(some) - 1}, in a new session: {wrong}"


def _begins_alike(target: TargetModule, cases: Cases) -> Iterator[str]:
    """Re-flights end once all is seen that they are flown for: what they show has to be what the whole flight did."""
    with opened(target) as session:
        for number, case in enumerate(cases or default_cases(target.describe())):
            whole = _fly(session, case)
            until_s = round(CUT_SHARE * (0.0 if whole.trace is None else whole.trace.duration_s), 3)
            for wrong in agreement.beginning_differences(whole, _fly(session, cut_off(case, until_s)), until_s):
                yield f"test case {number} with {until_s:g} s instead of {case.scenario.time_limit_s:g} s: {wrong}"


def _snapshots(target: TargetModule, cases: Cases) -> Iterator[str]:
    info = target.describe()
    with opened(target) as session:
        if not isinstance(session, ForkingSession):
            if info.snapshots:
                yield "describe() says it holds snapshots, but its sessions have no snapshot(), fly_from(), drop()"
            return
        for number, case in enumerate(cases or default_cases(info)):
            whole = _fly(session, case)
            for share in SHARES:
                at_s = round(share * (0.0 if whole.trace is None else whole.trace.duration_s), 3)
                snapshot = session.snapshot(case, at_s, DEADLINE_S, _never)
                for wrong in agreement.differences(whole, session.fly_from(snapshot, case, DEADLINE_S, _never)):
                    yield f"test case {number} from {at_s:g} s on: {wrong}"
            session.drop(snapshot)
            session.drop(snapshot)  # one already gone is fine


def _cancels(target: TargetModule, cases: Cases) -> Iterator[str]:
    info = target.describe()
    case = (cases or default_cases(info))[0]
    with opened(target) as session:
        try:
            session.fly(case, DEADLINE_S, lambda: True)
            yield "a flight that was cancelled from the start ended as if it was not"
        except Unavailable:
            pass
        yield from agreement.contradictions(info, case, _fly(session, case))


def _leaves(target: TargetModule, cases: Cases) -> Iterator[str]:
    before = set(children(os.getpid()))
    with opened(target) as session:
        for case in (cases or default_cases(target.describe()))[:1]:
            _fly(session, case)
        session.close()  # closed again at the end: twice is fine
    left = set(children(os.getpid())) - before
    if left:
        yield f"{len(left)} processes are still there after close()"


def _fly(session: Session, case: TestCase) -> FlightRecord:
    return session.fly(case, DEADLINE_S, _never)


def _never() -> bool:
    return False
