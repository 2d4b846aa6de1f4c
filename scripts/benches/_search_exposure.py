"""What the first flights of a search exposed: inputs by kind, modes and ground by flown time, rules aimed at."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from saflite.contract.flight import Flight, unpack_trace
from saflite.contract.signals import MODES
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement
from saflite.mutator.exposure.attention import read_note

_MODE_NAMES = {number: name for name, number in MODES.items()}


class Exposure:
    """Sums over first flights."""

    def __init__(self) -> None:
        self._inputs: Counter[str] = Counter()
        self._denied: Counter[str] = Counter()
        self._mode_s: dict[str, float] = {}
        self._flown_s = self._grounded_s = 0.0
        self._ways: Counter[str] = Counter()
        self._aimed: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
        self._steps: set[tuple[str, str]] = set()
        self._crashes: Counter[str] = Counter()

    def flew(self, case: TestCase, flight: Flight, packed: bytes) -> None:
        """Take a flight: what it was given, and where its time went."""
        self._ways[case.origin.note.partition(" ")[0]] += 1
        self._inputs.update(one.kind for one in case.stimuli)
        for one in flight.delivered or ():
            self._denied[case.stimuli[one.index].kind] += int(one.answer == "denied")
        if flight.ending == "crashed" and flight.delivered:
            last = case.stimuli[max(flight.delivered, key=lambda one: one.at_s).index]
            self._crashes[f"{last.kind} {last.name}"] += 1
        trace = unpack_trace(packed)
        self._flown_s += trace.duration_s
        down = (trace.array("landed") != 0.0) | (trace.array("armed") == 0.0)
        self._grounded_s += float(down.sum()) * trace.step_s
        for number, count in zip(*np.unique(trace.array("mode")[~down], return_counts=True), strict=True):
            name = _MODE_NAMES.get(int(number), str(number))
            self._mode_s[name] = self._mode_s.get(name, 0.0) + float(count) * trace.step_s

    def judged(self, case: TestCase, judgement: Judgement) -> None:
        """Take what the rules said: of those that the test case was made for, how many applied."""
        said = {one.policy: one.outcome for one in judgement.verdicts}
        self._steps |= {(step.before, step.after) for step in judgement.transitions}
        for policy, outcome in said.items():
            self._aimed[policy][2] += outcome in ("held", "violated")
        for policy in read_note(case.origin.note):
            self._aimed[policy][0] += 1
            self._aimed[policy][1] += said.get(policy) in ("held", "violated")

    def figures(self) -> dict[str, Any]:
        """Return shares and, per rule, flights aimed at it, those of them in which it applied, all in which it did."""
        flown_s = max(1e-9, self._flown_s)
        return {
            "ways": dict(self._ways),
            "inputs": dict(self._inputs),
            "denied": {kind: round(count / self._inputs[kind], 3) for kind, count in self._denied.items() if count},
            "grounded_share": round(self._grounded_s / flown_s, 3),
            "mode_shares": _shares(self._mode_s, flown_s),
            "crashed_after": dict(self._crashes.most_common()),
            "steps": len(self._steps),
            "rules": {policy: tuple(counts) for policy, counts in sorted(self._aimed.items())},
        }


def _shares(parts: Mapping[str, float], whole: float) -> dict[str, float]:
    return {name: round(part / whole, 3) for name, part in sorted(parts.items())}
