"""Findings of memory safety are kept out of what others get to see until each is released by its fingerprint.

The run itself keeps all of them: its store, recordings, test cases and what is told in the terminal.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import msgspec

from saflite.contract.events import Event, ViolationFound
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


def for_others(event: Event) -> Event:
    """Return an event as it may leave for a server of others: of a fault of memory neither message nor place."""
    fact = event.fact
    if not isinstance(fact, ViolationFound) or not is_memory_fault("autopilot_died", fact.violation.message):
        return event
    told = msgspec.structs.replace(fact.violation, message=withheld_words(1), behaviour="")
    return msgspec.structs.replace(event, fact=ViolationFound(violation=told))
