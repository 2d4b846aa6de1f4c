"""The shape all suites share: named checks that say in words what is wrong.

With pytest:  `@pytest.mark.parametrize("check", checks, ids=name_of)` and `assert findings([check]) == []`.
On the command line: `saflite conformance`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from saflite.contract.interrupts import interrupts


class Check(NamedTuple):
    """One thing that must hold. `run` yields in words where it does not; what it raises counts as one such place."""

    name: str
    run: Callable[[], Iterable[str]]


class Finding(NamedTuple):
    """A check that did not hold, and one place where."""

    check: str
    text: str


def name_of(check: Check) -> str:
    """Return the name of a check, as pytest shows it."""
    return check.name


def findings(checks: Iterable[Check]) -> list[Finding]:
    """Run the checks in order and return all that is wrong."""
    return [Finding(check.name, text) for check in checks for text in _wrong(check)]


def _wrong(check: Check) -> list[str]:
    found: list[str] = []
    try:
        with interrupts() as interrupted:
            for text in check.run():
                found.append(text)
    except BaseException as fault:  # code from outside is under test: whatever it raises is a finding
        if interrupted():
            raise KeyboardInterrupt from fault
        found.append(f"{type(fault).__name__}: {fault}")
    return found
