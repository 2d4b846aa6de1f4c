"""Why does a phase that was written for a rule not make the rule apply? Each phase of a clean search, told apart.

A phase is looked at in its own flight: from its first input to the next phase, which parts of the rule's condition were
true together at the best moment, and which were not. Rules that compare with a second flight are left out.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from _inline import Inline
from _search_run import Faulty, Job, campaign_of

from saflite.contract.flight import Flight, unpack_trace
from saflite.contract.test_case import TestCase
from saflite.contract.work import FlyResult, JudgeResult, Result
from saflite.mutator.exposure.attention import read_spans
from saflite.oracle.formula import Node, parts_of, text_of
from saflite.oracle.policy import load_policy
from saflite.oracle.signals import FlightSignals
from saflite.oracle.stl import Evaluator

APPLIED, OVER, NOT_LONG = "applied", "the flight was over", "not long enough"
TEXT_MAX = 100


class Seen(NamedTuple):
    """A phase as flown: its policy, its place in the flight, and what was lacking (or APPLIED, OVER)."""

    policy: str
    place: int
    lacking: tuple[str, ...]


class Watching:
    """Takes flights and judgements as they come."""

    def __init__(self, flights: Faulty) -> None:
        self._flights = flights
        self._flown: dict[str, Flight] = {}
        self.seen: list[Seen] = []
        self.applied = self.verdicts = 0

    def flew(self, result: Result) -> None:
        """Keep a first flight until it is judged."""
        if isinstance(result, FlyResult) and not result.flight.flight_index:
            self._flown[result.flight.test_case] = result.flight

    def judged(self, result: Result) -> None:
        """Look at the phases of a first flight."""
        if not isinstance(result, JudgeResult) or result.judgement.flight_index:
            return
        verdicts = result.judgement.verdicts
        self.applied += sum(one.outcome in ("held", "violated") for one in verdicts)
        self.verdicts += len(verdicts)
        case = self._flights.cases[result.judgement.test_case]
        self.seen += self._phases(case, self._flown.pop(result.judgement.test_case))

    def _phases(self, case: TestCase, flight: Flight) -> Iterator[Seen]:
        spans = read_spans(case.origin.note)
        if not spans or flight.trace is None:
            return
        trace = unpack_trace(self._flights.blobs.get(flight.trace), flight.trace_digest)
        signals = FlightSignals(case, flight, trace, between=True, is_log=False, untold=frozenset())
        told = {span.policy: load_policy(span.policy) for span in spans}
        policies = {name: policy for name, policy in told.items() if not policy.file.twin}
        if not policies:
            return
        shown = signals.pick(frozenset().union(*(policy.signals for policy in policies.values())))
        evaluator = Evaluator(shown, trace.step_s, signals.moments.row)
        times = evaluator.row * trace.step_s
        for place, span in enumerate(spans):
            if span.policy not in policies:
                continue
            until_s = spans[place + 1].from_s if place + 1 < len(spans) else np.inf
            window = (times >= span.from_s) & (times <= until_s)
            lacking = lacking_in(evaluator, policies[span.policy].formula, window) if window.any() else (OVER,)
            yield Seen(span.policy, place, lacking)


def lacking_in(evaluator: Evaluator, formula: Node, window: Any) -> tuple[str, ...]:
    """Return the parts of a rule's condition that were false when most of them were true, or (APPLIED,)."""
    nearest = -1.0
    lacking: tuple[str, ...] = (APPLIED,)
    for condition in conditions(formula):
        if (evaluator.trace(condition)[window] > 0).any():
            return (APPLIED,)
        parts = parts_of(condition)
        true = np.array([evaluator.trace(part)[window] > 0 for part in parts])
        best = int(true.sum(axis=0).argmax())
        if true[:, best].mean() > nearest:
            nearest = float(true[:, best].mean())
            false = [part for part, is_true in zip(parts, true[:, best], strict=True) if not is_true]
            lacking = tuple(text_of(part)[:TEXT_MAX] for part in false) or (NOT_LONG,)
    return lacking


def conditions(formula: Node) -> list[Node]:
    """Return the conditions of a rule's promises; none of a rule without."""
    body = formula.args[0] if formula.op == "always" else formula
    if body.op == "and":
        return [one for part in body.args for one in conditions(part)]
    return [body.args[0]] if body.op == "implies" else []


def phases(arm: str, rng_seed: int, budget: int) -> dict[str, Any]:
    """Return a row: per policy phases, those in which its rule applied, and what was lacking most in the others."""
    campaign, flights = campaign_of(Job(arm, (), (), rng_seed, budget)), Faulty(())
    with tempfile.TemporaryDirectory(prefix="saflite-phases-") as folder:
        watching = Watching(flights)
        inline = Inline(campaign, Path(folder) / "run", flights)
        inline.watch("fly", watching.flew)
        inline.watch("judge", watching.judged)
        inline.run(lambda _: False)
        inline.close()
    rules = {}
    for policy in sorted({one.policy for one in watching.seen}):
        mine = [one for one in watching.seen if one.policy == policy]
        lacking = Counter(part for one in mine for part in one.lacking if part != APPLIED)
        hit = sum(one.lacking == (APPLIED,) for one in mine)
        rules[policy] = {"phases": len(mine), "applied": hit, "lacking": dict(lacking.most_common(5))}
    places = [[one.lacking == (APPLIED,) for one in watching.seen if one.place == place] for place in range(10)]
    return {
        "arm": arm,
        "rng_seed": rng_seed,
        "budget": budget,
        "applied_share": round(watching.applied / max(1, watching.verdicts), 4),
        "by_place": [round(sum(one) / max(1, len(one)), 3) for one in places],
        "rules": rules,
    }
