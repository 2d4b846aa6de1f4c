"""Makes a violating test case smaller: drops, simplifies and shortens its inputs while it still violates. Pure.

An ask/tell machine. A generation is a few smaller test cases, all tried against the same best one. It is flown in
waves: `ask` gives for each test case as many flights as it takes at least to decide by the rule (`RepeatRule`) whether
it still violates; once every answer of a wave is there, the first in order that does becomes the best and the
generation is over. So the result does not depend on which flight came back first, and a wave is flown in parallel.
What the flights of a test case showed is kept, so one that comes up again needs only the flights still missing.

Order of work: keep only inputs of the names that were enough for another violation of the policy; end soon after the
moment that showed the violation, for what comes later has no part in it and every flight after that is shorter; drop
runs of inputs (halves, quarters, ... single ones: Zeller's ddmin), then simplify numbers (0, fewer digits), then
shorten (earlier inputs, an earlier end); from the dropping again as long as anything helped. A generation begins with
two test cases, for the first often violates and the others are flown for nothing; it is twice as wide after each that
did not help.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import msgspec

from saflite.campaign.lifecycle.repeats import RepeatRule
from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.test_case import Origin, Stimulus, TestCase, identity

Stimuli = tuple[Stimulus, ...]

EVERYTHING = (float("-inf"), float("inf"))
TAIL_S = 4.0  # least time a shortened flight goes on after its last input
PAUSES_S = (0.5, 1.0, 2.0)  # shorter pauses that are tried
DIGITS = (1, 2)
COMMAND_VALUES_MAX = 7  # of a vehicle command; more are bytes of a message
BATCH_LEAST, BATCH = 2, 4  # flights of the first wave of a generation; at least one test case
ENDS_AFTER_S = (1.0, TAIL_S)  # what was shown, where the flight is cut off


class Asked(NamedTuple):
    """One flight asked for: the `number`-th of a test case, from 0."""

    test_case: TestCase
    number: int


@dataclass(slots=True)
class Evidence:
    """What the flights of one test case showed."""

    flown: int = 0
    failed: int = 0


class Minimizer:
    """The search for the smallest violating test case. `flights_max` bounds the flights asked for.

    `shown_s` is the moment by which the violation was shown, if that is known, and `enough` are the inputs (`names_of`)
    of a smallest test case of another behaviour that violates the same policy, if there is one. `ranges` are those of
    inputs, by kind and name, whose values are to stay within: a find within documented ranges must not end outside.
    """

    def __init__(
        self,
        test_case: TestCase,
        flights_max: int,
        rule: RepeatRule,
        shown_s: float | None = None,
        enough: frozenset[str] = frozenset(),
        ranges: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.original = identity(test_case)
        self.rule = rule
        self._forms = [test_case]
        self._left = flights_max
        self._ranges = dict(ranges or {})
        self._decided = {self.original}
        self._evidence: dict[str, Evidence] = {}
        ends = () if shown_s is None else ended(test_case, shown_s)
        first = filter(_is_readable, (*reduced(test_case, enough), *ends))
        self._generation = {identity(case): case for case in first}  # not decided yet
        self._width = BATCH_LEAST
        self._wave: dict[tuple[str, int], bool | None] = {}
        self._phase = 0
        self._helped = False

    @property
    def best(self) -> TestCase:
        """The smallest test case known to violate."""
        return self._forms[-1]

    @property
    def forms(self) -> tuple[TestCase, ...]:
        """Every smaller test case that was the best for a time, the smallest last; empty where nothing helped."""
        return tuple(self._forms[1:])

    @property
    def left(self) -> int:
        """How many more flights may be asked for."""
        return self._left

    @property
    def done(self) -> bool:
        """Whether nothing smaller is left to try, or the flights are spent; nothing is under way then."""
        return not self._wave and (self._left <= 0 or (not self._generation and self._phase >= len(PHASES)))

    def ask(self) -> tuple[Asked, ...]:
        """Return the flights of the wave at hand that were not answered yet; empty once `done`."""
        while not self._wave and not self.done:
            if not self._generation and not self._begin_generation():
                self._next_phase()
            self._begin_wave()
        return tuple(Asked(self._generation[name], index) for (name, index), told in self._wave.items() if told is None)

    def tell(self, test_case: str, index: int, violates: bool) -> None:
        """Take the answer of one flight; one that was not asked for, or told before, is ignored."""
        if self._wave.get((test_case, index), violates) is not None:
            return
        self._wave[test_case, index] = violates
        if all(told is not None for told in self._wave.values()):
            self._end_wave()

    def validate(self) -> None:
        """Assert that the best test case is the original or has violated often enough."""
        name = identity(self.best)
        assert name == self.original or self._decide(name), f"{name} is taken to violate, but did not often enough"

    # ---- generations and waves -----------------------------------------------------------------------------------

    def _begin_generation(self) -> bool:
        smaller = filter(self._is_in_range, PHASES[self._phase](self.best))
        fresh = (case for case in smaller if identity(case) not in self._decided and _is_readable(case))
        many = max(1, self._width // self.rule.least_to_decide(0, 0))
        self._generation = {identity(case): case for case in islice(_unique(fresh), many)}
        return bool(self._generation)

    def _is_in_range(self, test_case: TestCase) -> bool:
        for one in test_case.stimuli:
            low, high = self._ranges.get(f"{one.kind} {one.name}", EVERYTHING)
            if not all(low <= value <= high for value in one.values):
                return False
        return True

    def _next_phase(self) -> None:
        self._phase += 1
        if self._phase >= len(PHASES) and self._helped:
            self._phase, self._helped = 0, False

    def _begin_wave(self) -> None:
        for name in self._generation:
            seen = self._evidence.setdefault(name, Evidence())
            many = min(self.rule.least_to_decide(seen.failed, seen.flown), self._left)
            self._wave.update({(name, seen.flown + ahead): None for ahead in range(many)})
            self._left -= many

    def _end_wave(self) -> None:
        for (name, _), violates in self._wave.items():
            self._evidence[name].flown += 1
            self._evidence[name].failed += bool(violates)
        self._wave = {}
        answers = {name: self._decide(name) for name in self._generation}
        self._decided |= {name for name, answer in answers.items() if answer is not None}
        better = next((case for name, case in self._generation.items() if answers[name]), None)
        if better is not None:
            self._forms.append(better)
            self._helped, self._generation, self._width = True, {}, BATCH_LEAST
        self._generation = {name: case for name, case in self._generation.items() if answers[name] is None}
        if better is None and not self._generation:
            self._width = min(BATCH, 2 * self._width)

    def _decide(self, name: str) -> bool | None:
        seen = self._evidence.get(name, Evidence())
        return self.rule.decide(seen.failed, seen.flown)


def _is_readable(test_case: TestCase) -> bool:
    """Whether a worker can read it: peers say when things happened, and no sum of such moments has bounds."""
    try:
        wire.checked(test_case, TestCase)
    except Refused:
        return False
    return True


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
        arm=test_case.origin.arm,
        parent=test_case.origin.parent if test_case.origin.note.startswith("shrunk") else identity(test_case),
        round=test_case.origin.round,
        index=test_case.origin.index,
        note=f"shrunk: {note}",
    )
    return msgspec.structs.replace(test_case, stimuli=stimuli, origin=origin)


# ---- the ways to get smaller --------------------------------------------------------------------------------------


def names_of(test_case: TestCase) -> frozenset[str]:
    """Return the inputs of a test case by kind and name."""
    return frozenset(f"{one.kind} {one.name}" for one in test_case.stimuli)


def reduced(test_case: TestCase, enough: frozenset[str]) -> Iterator[TestCase]:
    """Yield the test case with no inputs but those named, if that drops some and leaves some."""
    stimuli = tuple(one for one in test_case.stimuli if f"{one.kind} {one.name}" in enough)
    if 0 < len(stimuli) < len(test_case.stimuli):
        yield _with(test_case, stimuli, "as another of the policy")


def ended(test_case: TestCase, shown_s: float) -> Iterator[TestCase]:
    """Yield the test case without what comes after the violation was shown, the shortest first."""
    stimuli = tuple(stimulus for stimulus in test_case.stimuli if stimulus.at_s <= shown_s)
    scenario = test_case.scenario
    for after_s in ENDS_AFTER_S:
        limit_s = round(shown_s + after_s, 1)
        if scenario.mission is None and limit_s < scenario.time_limit_s:
            shorter = msgspec.structs.replace(scenario, time_limit_s=limit_s)
            yield msgspec.structs.replace(_with(test_case, stimuli, f"ends at {limit_s:g} s"), scenario=shorter)
    if len(stimuli) < len(test_case.stimuli):
        yield _with(test_case, stimuli, f"nothing after {shown_s:g} s")


def dropped(test_case: TestCase) -> Iterator[TestCase]:
    """Yield the test case without its twin, then without runs of inputs: all, halves, ... single ones, late first."""
    stimuli = test_case.stimuli
    if test_case.twin:
        yield _with(msgspec.structs.replace(test_case, twin=""), stimuli, "flown alone")
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
    if len(values) > COMMAND_VALUES_MAX:  # a message: fewer bytes
        for size in (1, len(values) // 4, len(values) // 2, 3 * len(values) // 4, len(values) - 1):
            yield values[:size]
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
