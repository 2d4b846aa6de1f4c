"""Makes a violating test case smaller: drops, simplifies and shortens its inputs while it still violates. Pure.

An ask/tell machine. `ask` gives one generation of smaller test cases, all tried against the same best one; once every
answer is there, the first in order that still violates becomes the best. So the result does not depend on which flight
came back first, and a generation can be flown in parallel.

Order of work: drop runs of inputs (halves, quarters, ... single ones: Zeller's ddmin), then simplify numbers (0, fewer
digits), then shorten (earlier inputs, an earlier end); from the start again as long as anything helped.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import msgspec

from saflite.contract.test_case import Origin, Stimulus, TestCase, identity

Stimuli = tuple[Stimulus, ...]

TAIL_S = 4.0  # least time a shortened flight goes on after its last input
PAUSES_S = (0.5, 1.0, 2.0)  # shorter pauses that are tried
DIGITS = (1, 2)
BATCH = 8  # test cases of one generation at most


class Minimizer:
    """The search for the smallest violating test case. `flights_max` bounds how many test cases are given out."""

    def __init__(self, test_case: TestCase, flights_max: int) -> None:
        self.original = identity(test_case)
        self._best = test_case
        self._left = flights_max
        self._tried = {self.original}
        self._pending: dict[str, TestCase] = {}
        self._answers: dict[str, bool] = {}
        self._phase = 0
        self._helped = False

    @property
    def best(self) -> TestCase:
        """The smallest test case known to violate."""
        return self._best

    @property
    def done(self) -> bool:
        """Whether nothing smaller is left to try, or the flights are spent; nothing is pending then."""
        return not self._pending and (self._phase >= len(PHASES) or self._left <= 0)

    def ask(self) -> tuple[TestCase, ...]:
        """Return the test cases still to be flown of the generation at hand; empty once `done`."""
        while not self._pending and not self.done:
            fresh = (case for case in PHASES[self._phase](self._best) if identity(case) not in self._tried)
            batch = tuple(islice(_unique(fresh), min(BATCH, self._left)))
            if batch:
                self._begin(batch)
            else:
                self._next_phase()
        return tuple(case for name, case in self._pending.items() if name not in self._answers)

    def _begin(self, batch: Sequence[TestCase]) -> None:
        self._pending = {identity(case): case for case in batch}
        self._tried |= set(self._pending)
        self._left -= len(batch)

    def _next_phase(self) -> None:
        self._phase += 1
        if self._phase >= len(PHASES) and self._helped:
            self._phase, self._helped = 0, False

    def tell(self, test_case: str, still_violates: bool) -> None:
        """Take an answer by the identity of a test case; one that is not pending, or told before, is ignored."""
        if test_case not in self._pending or test_case in self._answers:
            return
        self._answers[test_case] = still_violates
        if len(self._answers) < len(self._pending):
            return
        better = next((case for name, case in self._pending.items() if self._answers[name]), None)
        self._pending, self._answers = {}, {}
        if better is not None:
            self._best, self._helped = better, True


def _unique(cases: Iterator[TestCase]) -> Iterator[TestCase]:
    seen = set()
    for case in cases:
        name = identity(case)
        if name not in seen:
            seen.add(name)
            yield case


def _with(test_case: TestCase, stimuli: Stimuli, note: str) -> TestCase:
    origin = Origin(
        strategy=test_case.origin.strategy,
        parent=test_case.origin.parent if test_case.origin.note.startswith("shrunk") else identity(test_case),
        round=test_case.origin.round,
        index=test_case.origin.index,
        note=f"shrunk: {note}",
    )
    return msgspec.structs.replace(test_case, stimuli=stimuli, origin=origin)


# ---- the three ways to get smaller --------------------------------------------------------------------------------


def dropped(test_case: TestCase) -> Iterator[TestCase]:
    """Yield the test case without runs of inputs: all, halves, quarters, down to single ones; the latest first."""
    stimuli = test_case.stimuli
    size = len(stimuli)
    while size >= 1:
        for start in range(len(stimuli) - size, -1, -max(1, size)):
            rest = stimuli[:start] + stimuli[start + size :]
            yield _with(test_case, rest, f"dropped {size}")
        size //= 2


def simplified(test_case: TestCase) -> Iterator[TestCase]:
    """Yield the test case with simpler numbers: all of a command 0, single ones 0, fewer digits."""
    stimuli = test_case.stimuli
    for index, stimulus in enumerate(stimuli):
        for values in _simpler(stimulus):
            simple = msgspec.structs.replace(stimulus, values=values)
            yield _with(test_case, (*stimuli[:index], simple, *stimuli[index + 1 :]), f"simplified {stimulus.name}")


def _simpler(stimulus: Stimulus) -> Iterator[tuple[float, ...]]:
    values = stimulus.values
    if len(values) > 1 and any(values[1:]):
        yield (values[0], *(0.0 for _ in values[1:]))
    if len(values) > 1 and any(values):
        yield tuple(0.0 for _ in values)
    for place, value in enumerate(values):
        for simple in (0.0, *(float(f"{value:.{digits}g}") for digits in DIGITS)):
            if simple != value:
                yield (*values[:place], simple, *values[place + 1 :])


def shortened(test_case: TestCase) -> Iterator[TestCase]:
    """Yield the test case with an earlier end, the first input at once, and shorter pauses between inputs."""
    stimuli, scenario = test_case.stimuli, test_case.scenario
    last_s = max((stimulus.at_s for stimulus in stimuli), default=0.0)
    if scenario.mission is None:
        for share in (0.25, 0.5, 0.75):
            limit_s = round(max(last_s + TAIL_S, share * scenario.time_limit_s), 1)
            if limit_s < scenario.time_limit_s:
                shorter = msgspec.structs.replace(scenario, time_limit_s=limit_s)
                ends = _with(test_case, stimuli, f"ends at {limit_s:g} s")
                yield msgspec.structs.replace(ends, scenario=shorter)
    for index, stimulus in enumerate(stimuli):
        before_s = stimuli[index - 1].at_s if index else 0.0
        for pause_s in PAUSES_S:
            gain_s = stimulus.at_s - before_s - pause_s
            if gain_s > 1e-6:
                moved = tuple(_earlier(later, gain_s) for later in stimuli[index:])
                yield _with(test_case, (*stimuli[:index], *moved), f"{gain_s:.3g} s sooner")
                break


def _earlier(stimulus: Stimulus, by_s: float) -> Stimulus:
    return msgspec.structs.replace(stimulus, at_s=round(stimulus.at_s - by_s, 3))


PHASES = (dropped, simplified, shortened)
