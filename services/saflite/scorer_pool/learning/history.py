"""What earlier flights of the campaign showed, kept by round so that any cursor can be looked at again."""

from __future__ import annotations

import threading

import msgspec

from saflite.contract.errors import Unavailable
from saflite.contract.test_case import Mission, TestCase
from saflite.contract.work import Outcome


class History:
    """Outcomes told so far. Safe to use from several threads."""

    def __init__(self) -> None:
        self._rounds: dict[int, list[Outcome]] = {}
        self._missions: dict[str, Mission] = {}
        self._cursor = -1
        self._lock = threading.Lock()

    @property
    def cursor(self) -> int:
        """The round up to which outcomes were told; -1 for none."""
        return self._cursor

    def tell(self, outcomes: tuple[Outcome, ...], from_cursor: int, cursor: int) -> None:
        """Take outcomes of the rounds after `from_cursor` up to `cursor`, whole rounds; known ones are skipped.

        Raises:
            Unavailable: rounds are missing between what was told before and `from_cursor`; the work must be asked
                for again with the cursor of this history.
        """
        with self._lock:
            if from_cursor > self._cursor:
                raise Unavailable(f"told outcomes after round {from_cursor}, but known only up to {self._cursor}")
            known = frozenset(self._rounds)  # not all up to the cursor: who idled was told the latest rounds only
            for outcome in outcomes:
                if outcome.round not in known:
                    self._rounds.setdefault(outcome.round, []).append(self._slim(outcome))
            self._cursor = max(self._cursor, cursor)

    def view(self, since: int, cursor: int) -> tuple[Outcome, ...]:
        """Return the outcomes of the rounds after `since` up to `cursor`, in (round, index) order."""
        with self._lock:
            rounds = sorted(number for number in self._rounds if since < number <= cursor)
            return tuple(outcome for number in rounds for outcome in self._rounds[number])

    def _slim(self, outcome: Outcome) -> Outcome:
        """Drop the track and share the mission, so that 100,000 outcomes fit into memory."""
        return msgspec.structs.replace(outcome, track=(), test_case=self._shared(outcome.test_case))

    def _shared(self, test_case: TestCase) -> TestCase:
        mission = test_case.scenario.mission
        if mission is None:
            return test_case
        kept = self._missions.setdefault(mission.name, mission)
        if kept != mission:
            return test_case
        return msgspec.structs.replace(test_case, scenario=msgspec.structs.replace(test_case.scenario, mission=kept))
