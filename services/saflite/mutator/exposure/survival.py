"""What becomes of the vehicle in whose phases: it comes down, or nothing flies any more (a parachute, a fall)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest

from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Transition
from saflite.mutator.exposure.attention import read_spans
from saflite.mutator.exposure.state_model import flies

DOUBT, UNKNOWN = 2.0, 0.1  # phases flown that it weighs that nothing is known, and the share taken then


class Survival:
    """In whose phases the vehicle came down, and after whose it never flew again although more was to come."""

    def __init__(self) -> None:
        self._flown: Counter[str] = Counter()
        self._down: Counter[str] = Counter()
        self._last: Counter[str] = Counter()

    def tell(self, case: TestCase, transitions: Sequence[Transition], *, crashed: bool) -> None:
        """Learn from a flight whose origin tells when which policy's phase began."""
        spans = read_spans(case.origin.note)
        given = [step for step in transitions if 0 <= step.stimulus < len(case.stimuli)]
        steps = [(case.stimuli[step.stimulus].at_s, step) for step in given]
        for (policy, from_s, _), following in zip_longest(spans, spans[1:]):
            to_s = following.from_s if following is not None else math.inf
            if not any(flies(step.before) or flies(step.after) for at_s, step in steps if from_s <= at_s < to_s):
                continue
            later = [step for at_s, step in steps if at_s >= to_s]
            if not later and not crashed and following is None:
                continue
            self._flown[policy] += 1
            self._down[policy] += not (later and flies(later[0].before))
            self._last[policy] += not any(flies(step.before) or flies(step.after) for step in later)

    def comes_down(self, policy: str) -> float:
        """Return the share of a policy's phases in which the vehicle came down, or the flight ended."""
        return (self._down[policy] + UNKNOWN * DOUBT) / (self._flown[policy] + DOUBT)

    def ends(self, policy: str) -> float:
        """Return the share of a policy's phases after which nothing flew again."""
        return self._last[policy] / (self._flown[policy] + DOUBT)
