"""Flights that began the same are flown only once up to where they part: snapshots held where it pays.

Minimising and local search fly many test cases that differ late. When one agrees for a while with one flown shortly
before, the flight is held now and then on the stretch they share, and the next such flight starts from there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from math import inf
from typing import NamedTuple

from saflite.contract.clock import Clock
from saflite.contract.errors import Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import ForkingSession, Snapshot
from saflite.contract.test_case import Stimulus, TestCase

RECENT = 32  # test cases that are looked at for a common beginning
SPACING = 0.1  # least time between two snapshots, as a share of the time limit: holding costs, too


def agree_until_s(one: TestCase, other: TestCase) -> float:
    """Return the time up to which two flights are the same: when the first stimulus is due that only one of them has.

    Negative where they differ from the start, infinity where nothing differs.
    """
    if _beginning(one) != _beginning(other):
        return -1.0
    left, right = _in_order(one.stimuli), _in_order(other.stimuli)
    for index in range(max(len(left), len(right))):
        first, second = left[index : index + 1], right[index : index + 1]
        if first != second:
            return min(stimulus.at_s for stimulus in (*first, *second))
    return inf


def _beginning(one: TestCase) -> tuple[object, ...]:
    return one.target, one.scenario, one.rng_seed, one.heading_deg


def _in_order(stimuli: Sequence[Stimulus]) -> list[Stimulus]:
    return sorted(stimuli, key=lambda stimulus: stimulus.at_s)


class _Kept(NamedTuple):
    """A snapshot and the test case it was taken of."""

    snapshot: Snapshot
    test_case: TestCase

    def serves(self, test_case: TestCase) -> bool:
        """Whether the test case can be flown on from here."""
        return agree_until_s(self.test_case, test_case) >= self.snapshot.at_s


class Prefixes:
    """Flies on one session, from snapshots where it can; holds `most` of them at once."""

    def __init__(self, session: ForkingSession, clock: Clock, most: int) -> None:
        self._session, self._clock, self._most = session, clock, most
        self._recent: deque[TestCase] = deque(maxlen=RECENT)
        self._kept: list[_Kept] = []  # least recently used first

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once; the outcome is that of `Session.fly`, and so is what it raises."""
        until_s = self._clock.monotonic_s() + deadline_s
        shared_s = max((at_s for at_s in self._shared(test_case)), default=-1.0)
        self._recent.append(test_case)
        base = self._base(test_case)
        for at_s in self._moments(test_case, shared_s, base):
            with suppress(Unavailable):
                base = self._hold(test_case, at_s, until_s - self._clock.monotonic_s(), cancelled)
        left_s = until_s - self._clock.monotonic_s()
        if base is None:
            return self._session.fly(test_case, left_s, cancelled)
        return self._session.fly_from(base, test_case, left_s, cancelled)

    def close(self) -> None:
        """Let go of all snapshots."""
        while self._kept:
            self._session.drop(self._kept.pop().snapshot)

    def _shared(self, test_case: TestCase) -> list[float]:
        """Return how long the flight is that of each recent one; the very same flight does not count."""
        return [at_s for at_s in (agree_until_s(other, test_case) for other in self._recent) if at_s < inf]

    def _base(self, test_case: TestCase) -> Snapshot | None:
        """Return the latest snapshot that serves, and note that all that do were of use."""
        serving = [kept for kept in self._kept if kept.serves(test_case)]
        self._kept = [kept for kept in self._kept if kept not in serving] + serving
        return max((kept.snapshot for kept in serving), key=lambda snapshot: snapshot.at_s, default=None)

    def _moments(self, test_case: TestCase, shared_s: float, base: Snapshot | None) -> list[float]:
        """Return when to hold: at the start, and before stimuli on the shared stretch that are far enough apart."""
        spacing_s = SPACING * test_case.scenario.time_limit_s
        moments = [] if base is not None else [0.0]
        last_s = base.at_s if base is not None else 0.0
        for at_s in sorted({stimulus.at_s for stimulus in test_case.stimuli} | {shared_s}):
            if last_s + spacing_s <= at_s <= shared_s:
                moments.append(at_s)
                last_s = at_s
        return moments if shared_s >= 0.0 else []

    def _hold(self, test_case: TestCase, at_s: float, deadline_s: float, cancelled: Cancelled) -> Snapshot:
        if len(self._kept) >= self._most:
            self._drop_idle(test_case)
        snapshot = self._session.snapshot(test_case, at_s, deadline_s, cancelled)
        self._kept.append(_Kept(snapshot, test_case))
        return snapshot

    def _drop_idle(self, test_case: TestCase) -> None:
        """Let go of a snapshot the test case has no use for, and of those on the way from it."""
        idle = next((kept for kept in self._kept if not kept.serves(test_case)), None)
        if idle is None:
            raise Unavailable("as many snapshots as may be are in use")
        for kept in [kept for kept in self._kept if idle.serves(kept.test_case)]:
            if kept.snapshot.at_s >= idle.snapshot.at_s:
                self._kept.remove(kept)
                self._session.drop(kept.snapshot)
