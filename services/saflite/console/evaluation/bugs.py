"""The paper's second question: among all inputs a policy comes with, does a model find the one that triggers the bug?

For each of ten known bugs, every input of the published list is given a value by PGFuzz's own rules, the trigger the
value of the report, and all are scored. Told are the bands, the rank and band of the trigger, and the chance of drawing
it in a round: by PGFuzz (class first, then uniform), uniformly, and with the scores.

The Definition of Interestingness is that of our policy files, which name inputs that matter, or with `words="paper"`
the paper's own, which says less; without any words little is left to go by. Say which when you quote a figure: the
paper's words are the fair ones, ours were written by people who knew the bugs.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from typing import Literal, NamedTuple, Protocol

import msgspec
import numpy as np

from saflite.contract import wire
from saflite.contract.clock import Clock
from saflite.contract.errors import Refused
from saflite.contract.interval import Interval
from saflite.contract.rng import derive
from saflite.contract.score import Band, Score, band
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase, identity
from saflite.contract.work import ScoreResult, ScoreWork, WarmWork
from saflite.scorer_pool.model import BriefOf, PolicyBrief
from saflite.scorer_pool.work import ScorerPool

CLASSES = 3
BATCH = 10
COMMAND_VALUES = 7
UNBOUNDED_MAX = 10_000.0


class ListedInput(Protocol):
    """One input of a published list; bounds are NaN where none are published."""

    @property
    def kind(self) -> StimulusKind:
        """Parameter, command, stick, mode or sensor fault."""
        ...

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def low(self) -> float:
        """Least valid value."""
        ...

    @property
    def high(self) -> float:
        """Greatest valid value."""
        ...

    @property
    def whole(self) -> bool:
        """Whether values are whole numbers."""
        ...


Words = Literal["policy", "paper", "none"]
ListOf = Callable[[str], Sequence[ListedInput]]
"""Gives the inputs of a published list by its name; raises Refused for an unknown one."""


class Trigger(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The input that triggers a bug."""

    kind: StimulusKind
    name: str


class Bug(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One known bug as the paper puts it to the model."""

    id: str
    autopilot: str
    policy: str
    list: str
    state: str
    start: StartState
    trigger: Trigger
    class_size: int
    copies: int
    published_score: float
    paper_words: str
    trigger_values: tuple[float, ...] = ()


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    bugs: tuple[Bug, ...]


class BugResult(msgspec.Struct, frozen=True, kw_only=True):
    """What a model made of one bug. `rank` 1 is best, ties share the mean; chances are per round.

    `chance_band` draws uniformly from the best band that holds anything, `chance_weighted` by score.
    """

    bug: str
    policy: str
    model: str
    scored_by: dict[str, int]
    inputs: int
    bands: dict[Band, float]
    trigger: str
    trigger_score: float
    trigger_band: Band
    trigger_rank: float
    published_score: float
    chance_pgfuzz: float
    chance_uniform: float
    chance_band: float
    chance_weighted: float
    faults: dict[str, int]


@cache
def bugs() -> tuple[Bug, ...]:
    """Return the ten bugs; raises Refused if the data file is damaged."""
    text = files("saflite.console.evaluation").joinpath("data/rq2_bugs.toml").read_text(encoding="utf-8")
    try:
        return wire.convert(tomllib.loads(text), _File).bugs
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as fault:
        raise Refused("rq2_bugs.toml", expected="a list of bugs", got=str(fault)) from fault


def value_of(listed: ListedInput, rng: np.random.Generator) -> tuple[float, ...]:
    """Return a value by PGFuzz's published rules, its dead branch (no bounds: always 0) included."""
    if listed.kind == "mode":
        return ()
    if listed.kind == "command":
        return (2.0,) if "PARACHUTE" in listed.name else tuple(map(float, rng.integers(1, 101, COMMAND_VALUES)))
    if listed.kind == "stick":
        pulses = (1000, 2001) if listed.name == "RC3" else (1200, 1901)
        return (float(rng.integers(*pulses)),)
    if listed.kind == "sensor_fault":
        return (float(rng.uniform(0.0, 100.0)),)
    if np.isnan(listed.low):
        return (0.0,)
    high = UNBOUNDED_MAX if np.isnan(listed.high) else listed.high
    if listed.whole:
        return (float(rng.integers(int(listed.low), int(high) + 1)),)
    return (float(rng.uniform(listed.low, high)),)


class Question(NamedTuple):
    """All inputs of one bug as test cases, and which of them is the trigger."""

    test_cases: tuple[TestCase, ...]
    trigger: str


def question(bug: Bug, inputs: Sequence[ListedInput], rng_seed: int) -> Question:
    """Return the test cases of a bug; raises Refused if the trigger is not in the list."""
    rng = derive(rng_seed, "evaluate bugs", bug.id)
    cases: dict[str, TestCase] = {}
    trigger = ""
    for listed in inputs:
        is_trigger = (listed.kind, listed.name) == (bug.trigger.kind, bug.trigger.name)
        values = value_of(listed, rng)
        if is_trigger and bug.trigger_values:
            values = bug.trigger_values
        given = Stimulus(at_s=1.0, kind=listed.kind, name=listed.name, values=values)
        scenario = Scenario(start=bug.start, time_limit_s=60.0)
        case = TestCase(target=Target(name=bug.autopilot.lower()), scenario=scenario, stimuli=(given,))
        cases[identity(case)] = case
        trigger = identity(case) if is_trigger else trigger
    if not trigger:
        raise Refused(f"bug {bug.id}", expected=f"{bug.trigger.name} in list {bug.list}", got="it is not there")
    return Question(tuple(cases.values()), trigger)


def evaluate_bug(
    bug: Bug,
    model: str,
    list_of: ListOf,
    brief_of: BriefOf,
    clock: Clock,
    *,
    rng_seed: int = 1,
    deadline_s: float = 60.0,
    words: Words = "policy",
) -> BugResult:
    """Return what `model` makes of one bug; raises Refused for an unknown policy, list or model."""
    asked = question(bug, list_of(bug.list), rng_seed)
    brief = _worded(brief_of(bug.policy, None)._replace(state=bug.state), bug, words)
    pool = ScorerPool(lambda name, texts: brief if name == bug.policy else brief_of(name, texts), clock)
    try:
        scores = _scored(pool, asked.test_cases, bug, model, rng_seed, deadline_s)
    finally:
        pool.close()
    return _result(bug, model, asked, scores)


def _worded(brief: PolicyBrief, bug: Bug, words: Words) -> PolicyBrief:
    if words == "policy":
        return brief
    return brief._replace(interestingness=bug.paper_words if words == "paper" else "", inputs=())


def _scored(
    pool: ScorerPool, cases: tuple[TestCase, ...], bug: Bug, model: str, rng_seed: int, deadline_s: float
) -> list[Score]:
    pool.do(WarmWork(model=model), lambda: False)  # or the embedded scorer would answer while it loads
    scores: list[Score] = []
    for start in range(0, len(cases), BATCH):
        work = ScoreWork(
            round=0,
            model=model,
            shadow=(),
            policies=(bug.policy,),
            test_cases=cases[start : start + BATCH],
            rng_seed=rng_seed,
            deadline_s=deadline_s,
        )
        result = pool.do(work, lambda: False)
        assert isinstance(result, ScoreResult), result
        scores.extend(result.scores)
    return scores


def _result(bug: Bug, model: str, asked: Question, scores: list[Score]) -> BugResult:
    values = {score.test_case: score.value for score in scores}
    own = values[asked.trigger]
    above = sum(value > own for value in values.values())
    ties = sum(value == own for value in values.values())
    in_band = [band(value) for value in values.values()]
    best: Band = next(name for name in ("interesting", "middling", "dull") if name in in_band)
    total = sum(values.values())
    faults = [score.fault for score in scores if score.fault]
    return BugResult(
        bug=bug.id,
        policy=bug.policy,
        model=model,
        scored_by={name: sum(score.scored_by == name for score in scores) for name in {s.scored_by for s in scores}},
        inputs=len(values),
        bands={name: 100.0 * in_band.count(name) / len(values) for name in ("interesting", "middling", "dull")},
        trigger=bug.trigger.name,
        trigger_score=own,
        trigger_band=band(own),
        trigger_rank=above + (ties + 1) / 2,
        published_score=bug.published_score,
        chance_pgfuzz=bug.copies / bug.class_size / CLASSES,
        chance_uniform=1.0 / len(values),
        chance_band=1.0 / in_band.count(best) if band(own) == best else 0.0,
        chance_weighted=own / total if total > 0 else 1.0 / len(values),
        faults={name: faults.count(name) for name in set(faults)},
    )


def evaluate_bugs(
    model: str,
    list_of: ListOf,
    brief_of: BriefOf,
    clock: Clock,
    *,
    rng_seed: int = 1,
    deadline_s: float = 60.0,
    words: Words = "policy",
) -> tuple[BugResult, ...]:
    """Return what `model` makes of each of the ten bugs."""
    return tuple(
        evaluate_bug(bug, model, list_of, brief_of, clock, rng_seed=rng_seed, deadline_s=deadline_s, words=words)
        for bug in bugs()
    )


def gain(results: Sequence[BugResult]) -> Interval:
    """Return by how much drawing by score beats PGFuzz's own draw: geometric mean over the triggers.

    Ten bugs have six triggers: bugs of one trigger are no independent evidence and count as one. The interval is
    Student's on the logarithms; with one trigger there is none.
    """
    from scipy.stats import t

    by_trigger: dict[str, list[float]] = {}
    for one in results:
        by_trigger.setdefault(one.trigger, []).append(float(np.log(max(one.chance_weighted, 1e-9) / one.chance_pgfuzz)))
    if not by_trigger:
        return Interval()
    logs = np.array([np.mean(ratios) for ratios in by_trigger.values()])
    value = float(np.exp(logs.mean()))
    if len(logs) < 2:
        return Interval(value=value)
    half = float(t.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs)))
    return Interval(value=value, low=value / float(np.exp(half)), high=value * float(np.exp(half)))
