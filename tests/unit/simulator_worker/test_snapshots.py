"""Flying on from snapshots: the outcome of a flight from the start, no process left, held only where it pays."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from itertools import pairwise
from multiprocessing import Pipe

import msgspec
import pytest

from saflite.conformance.flying import opened
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.target import Snapshot
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.forks import _answer
from saflite.simulator_worker.prefixes import Prefixes, agree_until_s
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.targets import reference
from saflite.simulator_worker.targets.reference import ReferenceSession

DEADLINE_S = 60.0


def never() -> bool:
    return False


def given(at_s: float, kind: StimulusKind, name: str, *values: float) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)


def case(*stimuli: Stimulus, limit_s: float = 14.0, rng_seed: int = 3) -> TestCase:
    scenario = Scenario(start=StartState(mode="LOITER", altitude_m=4.0), time_limit_s=limit_s)
    return TestCase(target=Target(), scenario=scenario, stimuli=stimuli, rng_seed=rng_seed)


CLIMB = given(1.0, "stick", "RC3", 1700.0)
REFUSED = given(2.0, "parameter", "RTL_ALT", -5.0)
LAND = given(3.0, "mode", "LAND")
STOP = given(3.5, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 0.0, 21196.0)
LATE = given(12.0, "command", "MAV_CMD_NAV_TAKEOFF", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0)
GUST = given(6.0, "sensor_fault", "SIM_WIND_SPD", 6.0)


@pytest.fixture
def others() -> list[int]:
    """Processes that tests before this one have left to themselves."""
    return children(os.getpid())


@pytest.fixture
def session(others: list[int]) -> Iterator[ReferenceSession]:
    with opened(reference) as session:
        assert isinstance(session, ReferenceSession)
        yield session
    assert children(os.getpid()) == others


def same(session: ReferenceSession, snapshot: Snapshot, test_case: TestCase) -> FlightRecord:
    whole = session.fly(test_case, DEADLINE_S, never)
    assert list(differences(whole, session.fly_from(snapshot, test_case, DEADLINE_S, never))) == []
    return whole


@pytest.mark.parametrize("at_s", [0.0, 2.0, 2.01, 5.99])
def test_flown_on_as_from_the_start(session: ReferenceSession, at_s: float) -> None:
    held = session.snapshot(case(CLIMB, REFUSED, GUST), at_s, DEADLINE_S, never)
    for test_case in (
        case(CLIMB, REFUSED, GUST),
        case(REFUSED, CLIMB),  # another order in the file, another place of what was given
        case(CLIMB, REFUSED, LAND, LATE),  # differs from 3 s on: where the snapshot is later, flown from the start
    ):
        record = same(session, held, test_case)
        assert record.delivered is not None
        answers = {test_case.stimuli[one.index].name: one.answer for one in record.delivered}
        assert (answers["RC3"], answers["RTL_ALT"]) == ("accepted", "denied")


def test_a_flight_that_had_ended_before_the_snapshot_ends_there(session: ReferenceSession) -> None:
    down = given(0.5, "mode", "LAND")
    held = session.snapshot(case(down, LATE), 11.0, DEADLINE_S, never)
    ended = same(session, held, case(down))
    assert ended.trace is not None
    assert ended.trace.duration_s < 11.0
    went_on = same(session, held, case(down, LATE))
    assert went_on.trace is not None
    assert went_on.trace.duration_s > 12.0


def test_snapshots_on_the_way_from_others(session: ReferenceSession) -> None:
    some = case(CLIMB, REFUSED, GUST)
    held = [session.snapshot(some, at_s, DEADLINE_S, never) for at_s in (0.0, 1.5, 4.0, 7.0)]
    same(session, held[3], some)
    session.drop(held[1])  # and with it those held on from it
    same(session, held[3], some)
    same(session, held[0], some)


def kill_what_was_forked_ahead(others: list[int]) -> None:
    (holder,) = (pid for pid in children(os.getpid()) if pid not in others)
    while not (ahead := [pid for pid in children(holder) if not children(pid)]):
        pass
    for pid in ahead:
        os.kill(pid, signal.SIGKILL)


def test_a_fork_made_ahead_that_was_killed_costs_only_its_snapshot(
    session: ReferenceSession, others: list[int]
) -> None:
    held = session.snapshot(case(CLIMB), 1.5, DEADLINE_S, never)
    same(session, held, case(CLIMB, LAND))
    kill_what_was_forked_ahead(others)
    same(session, held, case(CLIMB, GUST))
    session.drop(held)
    session.snapshot(case(CLIMB), 1.5, DEADLINE_S, never)
    kill_what_was_forked_ahead(others)
    with pytest.raises(Unavailable, match="died"):
        session.snapshot(case(CLIMB), 2.0, DEADLINE_S, never)


def test_an_order_larger_than_a_socket_holds(session: ReferenceSession) -> None:
    many = case(CLIMB, *(given(2.0, "stick", "RC3", 1500.0 + k % 100) for k in range(9_000)), limit_s=3.0)
    same(session, session.snapshot(many, 1.5, DEADLINE_S, never), many)


def test_what_cannot_be_held_is_said(session: ReferenceSession) -> None:
    with pytest.raises(Unavailable, match="ends before"):
        session.snapshot(case(STOP, limit_s=5.0), 6.0, DEADLINE_S, never)
    with pytest.raises(Unavailable):
        session.snapshot(case(CLIMB), 2.0, DEADLINE_S, lambda: True)
    held = session.snapshot(case(CLIMB), 0.5, DEADLINE_S, never)
    with pytest.raises(Unavailable, match="cancelled"):
        session.fly_from(held, case(CLIMB, GUST), DEADLINE_S, lambda: True)
    with pytest.raises(Refused, match="command"):
        session.fly_from(held, case(CLIMB, given(5.0, "command", "NO_SUCH")), DEADLINE_S, never)
    assert session.fly_from(held, case(CLIMB, GUST), 0.0, never).ending == "wedged"
    assert session.fly(case(CLIMB), 0.0, never).ending == "wedged"


def test_who_stopped_from_the_start_gets_no_answer_that_is_there_already() -> None:
    ours, theirs = Pipe()
    theirs.send_bytes(b"done")
    with pytest.raises(Unavailable, match="cancelled"):
        _answer(ours, lambda: True)
    assert _answer(ours, never) == b"done"


def test_how_long_two_flights_agree() -> None:
    assert agree_until_s(case(CLIMB, LAND), case(LAND, CLIMB)) == float("inf")
    assert agree_until_s(case(CLIMB, LAND), case(CLIMB)) == 3.0
    assert agree_until_s(case(CLIMB, GUST), case(CLIMB, LAND)) == 3.0
    assert agree_until_s(case(CLIMB), case(CLIMB, rng_seed=4)) < 0.0
    assert agree_until_s(case(), case(CLIMB, limit_s=20.0)) < 0.0


class Counted(ReferenceSession):
    """A session that counts what it is asked."""

    def __init__(self) -> None:
        super().__init__(WallClock())
        self.held: list[float] = []
        self.flown_from: list[float] = []

    def snapshot(self, *given: object) -> Snapshot:
        found = super().snapshot(*given)  # type: ignore[arg-type]
        self.held.append(found.at_s)
        return found

    def fly_from(self, snapshot: Snapshot, *given: object) -> FlightRecord:
        self.flown_from.append(snapshot.at_s)
        return super().fly_from(snapshot, *given)  # type: ignore[arg-type]


def test_flights_that_began_the_same_share_their_beginning() -> None:
    before, counted = children(os.getpid()), Counted()
    shared = Prefixes(counted, WallClock(), most=3)
    whole = case(CLIMB, REFUSED, LAND, GUST, given(9.0, "mode", "RTL"), limit_s=12.0)
    smaller = [
        msgspec.structs.replace(whole, stimuli=(*whole.stimuli[:place], *whole.stimuli[place + 1 :]))
        for place in range(len(whole.stimuli))
    ]
    for test_case in (whole, *smaller, whole):
        record = shared.fly(test_case, DEADLINE_S, never)
        assert list(differences(counted.fly(test_case, DEADLINE_S, never), record)) == []
        assert len(children(os.getpid())) <= len(before) + 3
    assert counted.flown_from[0] == 0.0
    assert all(one <= other for one, other in pairwise(counted.flown_from))
    assert max(counted.flown_from) >= 3.0
    shared.close()
    counted.close()
    assert children(os.getpid()) == before


def test_flights_with_nothing_in_common_hold_nothing() -> None:
    counted = Counted()
    shared = Prefixes(counted, WallClock(), most=3)
    for rng_seed in range(3):
        shared.fly(case(limit_s=1.0, rng_seed=rng_seed), DEADLINE_S, never)
    shared.fly(case(limit_s=1.0, rng_seed=0), DEADLINE_S, never)  # the very same again is flown again
    assert (counted.held, counted.flown_from) == ([], [])
    counted.close()
