"""Findings of memory safety are kept out of what others get to see until each is released by its fingerprint.

The run itself keeps all of them: its store, recordings, test cases and what is told in the terminal.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Container, Iterable

import msgspec

from saflite.contract.events import Event, Flown, ViolationFound
from saflite.contract.flight import AUTOPILOT_ALIVE
from saflite.contract.memory_faults import is_memory_fault
from saflite.recorder.summary import Finding

Released = Collection[str]
"""Fingerprints of findings, or the start of them; `ALL` for every one."""

ALL = "all"


def is_public(finding: Finding, released: Released) -> bool:
    """Return whether a finding may be shown to others."""
    embargoed = finding.circumstances is not None and finding.circumstances.memory_safety
    return not embargoed or any(one == ALL or finding.violation.fingerprint.startswith(one) for one in released)


def split(findings: Iterable[Finding], released: Released) -> tuple[list[Finding], list[Finding]]:
    """Return the findings that may be shown to others, and those that may not."""
    shown, hidden = list[Finding](), list[Finding]()
    for one in findings:
        (shown if is_public(one, released) else hidden).append(one)
    return shown, hidden


def withheld_words(count: int) -> str:
    """Return in words that findings are kept back."""
    return f"{count} {'finding' if count == 1 else 'findings'} of memory safety withheld"


class ToldFaults:
    """Which test cases may have shown a fault of memory, by the events of a run told from the first on.

    As for `RunFolder.memory_faults`, any flight counts. The event of a flight does not say what an autopilot died of: a
    find may, of the flight that it names; what nobody says counts. Methods may be called from several threads.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.begin()

    def begin(self) -> None:
        """Forget all: the events are those of another run."""
        with self._lock:
            self.next_seq = 1
            self._faults, self._died = set[str](), dict[str, set[int]]()
            self._explained: dict[str, set[int]] = {}

    def take(self, event: Event) -> None:
        """Note an event; one that is not the next is passed over."""
        with self._lock:
            if event.seq != self.next_seq:
                return
            self.next_seq += 1
            fact = event.fact
            if isinstance(fact, Flown) and fact.ending == "autopilot_died":
                self._died.setdefault(fact.test_case, set()).add(fact.flight_index)
            elif isinstance(fact, ViolationFound) and is_memory_fault("autopilot_died", fact.violation.message):
                self._faults.add(fact.violation.test_case)
            elif isinstance(fact, ViolationFound) and fact.violation.policy == AUTOPILOT_ALIVE:
                self._explained.setdefault(fact.violation.test_case, set()).add(fact.violation.flight_index)

    def knows(self, event: Event) -> bool:
        """Whether all was told up to an event."""
        with self._lock:
            return event.seq < self.next_seq

    def __contains__(self, test_case: object) -> bool:
        """Whether a flight of a test case died of a fault of memory, or of what nobody said."""
        with self._lock:
            name = str(test_case)
            return name in self._faults or not self._died.get(name, set()) <= self._explained.get(name, set())


def for_others(event: Event, faults: Container[str]) -> Event:
    """Return an event as it may leave for a server of others: of a find neither message nor place if it is private.

    `faults` has the test cases any flight of which died of a fault of memory, where the books or all events tell.
    """
    fact = event.fact
    if not isinstance(fact, ViolationFound):
        return event
    if fact.violation.test_case not in faults and not is_memory_fault("autopilot_died", fact.violation.message):
        return event
    told = msgspec.structs.replace(fact.violation, message=withheld_words(1), behaviour="")
    return msgspec.structs.replace(event, fact=ViolationFound(violation=told))
