"""What people read of known violations on other builds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from saflite.console.operations.regressing import Regressed
from saflite.contract.plain import counted, word


def line(result: Regressed) -> str:
    """Return a known violation in one line."""
    words = f"  {word(result.words)}" if result.words else ""
    return f"{result.state:<11}  {result.known.fingerprint}  {result.known.policy}  {result.rate}{words}"


def plain(result: Regressed) -> dict[str, Any]:
    """Return it for scripts."""
    return {
        "fingerprint": result.known.fingerprint,
        "test_case": result.known.name,
        "policy": result.known.policy,
        "state": result.state,
        "violated": result.violated,
        "judged": result.judged,
        "lost": result.lost,
        "fresh_noise": {"violated": result.fresh[0], "judged": result.fresh[1]},
        "words": result.words,
        "build": result.build,
    }


def summary(results: Sequence[Regressed]) -> str:
    """Return all of them in one line."""
    if not results:
        return "no known violation: nothing to fly again"
    counts = Counter(result.state for result in results)
    states = ", ".join(f"{count} {state}" for state, count in counts.items())
    return f"{counted(len(results), 'known violation')}: {states}"
