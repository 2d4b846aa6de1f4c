"""What a target is: something one asks what it can do, opens, flies many test cases with, and closes.

A target is a vehicle with its autopilot. What it says of itself (`TargetInfo`) drives the mutator, the campaigns and
the console; nobody asks for its name. One module per target holds

    describe() -> TargetInfo            cheap, no simulator started; raises Unavailable where it cannot even tell
    check(test_case) -> None            raises Refused where this target cannot fly the test case
    open(slot) -> Session               bring-up; raises Unavailable where something it needs is missing
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from saflite.contract.clock import Clock
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase


@dataclass(frozen=True, slots=True, kw_only=True)
class Slot:
    """Where a session lives on its host.

    `index` is unique among the sessions of a host; `folder` is private to the session and empty at the start;
    `ports` may be bound by it and nobody else; `namespace` is the network namespace it runs in, empty for the host's.
    """

    index: int
    folder: Path
    clock: Clock
    ports: range = range(0)
    namespace: str = ""


class Session(Protocol):
    """An open target. Used from one thread; result (B after A) equals result (B alone).

    Where the target says that flights repeat bit by bit, a session may except test cases by `repeatable(test_case)`.
    """

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once, within `deadline_s` of wall time.

        A flight is the beginning of the one with a later `time_limit_s`: re-flights end when all was seen that counts.

        Raises:
            Refused: the test case cannot be flown on this target.
            Unavailable: bring-up failed, or it was cancelled.
        """
        ...

    def close(self) -> None:
        """End everything the session started; may be called twice."""
        ...


class Snapshot(NamedTuple):
    """A held state of a flight: `handle` is the session's own; good until the session drops or closes it."""

    handle: int
    at_s: float


@runtime_checkable
class ForkingSession(Session, Protocol):
    """A session that can hold a flight at a moment and fly on from there, any number of times.

    The outcome of `fly_from` equals that of `fly` for every test case that agrees with the one the snapshot was taken
    of in target, scenario, rng_seed and all stimuli due before `Snapshot.at_s`, also where the snapshot is gone.
    """

    def snapshot(self, test_case: TestCase, at_s: float, deadline_s: float, cancelled: Cancelled) -> Snapshot:
        """Fly until just before what is due at `at_s` (0 is the start state) and hold there.

        Raises:
            Refused: the test case cannot be flown on this target.
            Unavailable: the flight ends before, it took longer than `deadline_s`, or it was cancelled.
        """
        ...

    def fly_from(
        self, snapshot: Snapshot, test_case: TestCase, deadline_s: float, cancelled: Cancelled
    ) -> FlightRecord:
        """Fly the test case on from the snapshot; raises what `fly` raises."""
        ...

    def drop(self, snapshot: Snapshot) -> None:
        """Let go of a snapshot, and of any held on from it; one already gone is fine."""
        ...


class TargetModule(Protocol):
    """What a target module offers."""

    def describe(self) -> TargetInfo:
        """Say what the target is and can do."""
        ...

    def check(self, test_case: TestCase) -> None:
        """Raise Refused where the test case cannot be flown."""
        ...

    def open(self, slot: Slot) -> Session:
        """Bring the target up."""
        ...
