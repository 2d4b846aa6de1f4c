"""What every scorer model promises: one score in 0..10 per test case, the same whoever asks and in what company.

    from saflite.conformance.kit import findings
    from saflite.conformance.scorers import check_scorer, open_model

    assert findings(check_scorer(lambda: open_model("my-scorer"))) == []

Models that ask a server are held to the same, with a server that answers the same question the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import msgspec

from saflite.conformance.kit import Check
from saflite.contract.rng import derive
from saflite.contract.score import SCORE_MAX, SCORE_MIN
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.work import Outcome
from saflite.flight.mission import builtin_mission
from saflite.scorer_pool.model import Job, Model, PolicyBrief, Tools
from saflite.scorer_pool.registry import make

BRIEFS = (
    PolicyBrief("min-obstacle-distance", "Keep 1.5 m from obstacles.", ("obstacle_distance_m",)),
    PolicyBrief("a-chute", "Deploying a parachute needs armed motors and no FLIP or ACRO mode.", ("chute_released",)),
)
INPUTS = ("MAV_CMD_DO_PARACHUTE", "SIM_GPS_DISABLE", "ATC_RAT_RLL_FF", "UNHEARD_OF")
FLOWN = (0, 40)

Open = Callable[[], Model]
Promise = Callable[[Open, int], Iterator[str]]


class StillClock:
    """A clock that stands: no deadline ever passes."""

    def monotonic_s(self) -> float:
        """Return 0."""
        return 0.0

    def unix_s(self) -> float:
        """Return 0."""
        return 0.0


def open_model(label: str) -> Model:
    """Return a model with those it is built of, all new; raises Refused for an unknown kind or a bad argument."""
    made: dict[str, Model] = {}

    def get(name: str) -> Model:
        if name not in made:
            made[name] = make(name, Tools(StillClock(), get))
        return made[name]

    return get(label)


def check_scorer(open_one: Open) -> tuple[Check, ...]:
    """Return the checks of a scorer model, before any flight and after 40; each opens models of its own."""
    promises: tuple[Promise, ...] = (
        one_score_from_0_to_10_per_test_case,
        same_scores_from_another_instance_in_other_company_and_order,
        the_origin_of_a_test_case_does_not_matter,
        nothing_asked_nothing_scored,
        warms_and_closes,
    )
    return tuple(
        Check(f"{promise.__name__}_after_{flown}_flights", partial(promise, open_one, flown))
        for flown in FLOWN
        for promise in promises
    )


def job(flown: int = 0, cases: tuple[TestCase, ...] | None = None, rng_seed: int = 3) -> Job:
    """Return the question all checks ask: eight test cases, or `cases`, after so many flights."""
    return Job(CASES if cases is None else cases, BRIEFS, rng_seed, 9, HISTORY[:flown], 5 if flown else -1)


def one_score_from_0_to_10_per_test_case(open_one: Open, flown: int) -> Iterator[str]:
    """Each test case has a score in 0..10 with its reason; the answer names what gave it by digest."""
    sheet = open_one().score(job(flown))
    if len(sheet.scores) != len(CASES):
        yield f"{len(sheet.scores)} scores for {len(CASES)} test cases"
    if not sheet.digest:
        yield "the answer bears no digest of the model"
    for place, score in enumerate(sheet.scores):
        if not SCORE_MIN <= score.value <= SCORE_MAX:
            yield f"test case {place}: score {score.value}, expected {SCORE_MIN:g} to {SCORE_MAX:g}"
        if score.fault:
            yield f"test case {place}: {score.fault}"
        if not score.reason:
            yield f"test case {place}: no reason given"


def same_scores_from_another_instance_in_other_company_and_order(open_one: Open, flown: int) -> Iterator[str]:
    """A score depends on the test case, the random seed and the history alone."""
    whole = _values(open_one(), job(flown))
    other = open_one()
    if _values(other, job(flown, CASES[::-1]))[::-1] != whole:
        yield "another instance, asked in another order, scores otherwise"
    if [_values(other, job(flown, (case,)))[0] for case in CASES] != whole:
        yield "test cases asked one by one are scored otherwise"


def the_origin_of_a_test_case_does_not_matter(open_one: Open, flown: int) -> Iterator[str]:
    """Who proposed a test case, and in which round, says nothing of what it will do."""
    renamed = tuple(
        msgspec.structs.replace(case, origin=msgspec.structs.replace(case.origin, strategy="other", round=77))
        for case in CASES
    )
    model = open_one()
    if _values(model, job(flown, renamed)) != _values(model, job(flown)):
        yield "the same test cases from another strategy are scored otherwise"


def nothing_asked_nothing_scored(open_one: Open, flown: int) -> Iterator[str]:
    """A job without test cases has an answer without scores."""
    scores = open_one().score(job(flown, ())).scores
    if scores:
        yield f"{len(scores)} scores for no test case"


def warms_and_closes(open_one: Open, flown: int) -> Iterator[str]:
    """A model says in a line that it is ready, and closes."""
    model = open_one()
    if not model.warm(lambda: False):
        yield "warm() says nothing"
    model.close()


def _values(model: Model, asked: Job) -> list[float]:
    return [score.value for score in model.score(asked).scores]


def layout(seed: int) -> TestCase:
    """Return a mission among two boxes drawn from `seed`."""
    rng = derive(seed, "layout")
    boxes = tuple(
        Obstacle(
            length_m=float(rng.uniform(2, 15)),
            width_m=float(rng.uniform(2, 15)),
            height_m=20.0,
            x_m=float(rng.uniform(-20, 20)),
            y_m=float(15 + 20 * place + rng.uniform(-3, 3)),
            rotation_deg=float(rng.uniform(0, 90)),
        )
        for place in range(2)
    )
    return TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2"), obstacles=boxes))


def stimulus(seed: int) -> TestCase:
    """Return a flight disturbed by a command drawn from `seed` and a change of mode."""
    rng = derive(seed, "stimulus")
    stimuli = (
        Stimulus(at_s=1.0, kind="command", name=INPUTS[int(rng.integers(4))], values=(float(rng.uniform(-1, 5)),)),
        Stimulus(at_s=2.0, kind="mode", name="ACRO"),
    )
    return TestCase(target=Target(), scenario=Scenario(start=StartState()), stimuli=stimuli, rng_seed=seed)


def history(count: int) -> tuple[Outcome, ...]:
    """Return what came of `count` flights."""
    cases = [layout(100 + seed) if seed % 2 else stimulus(100 + seed) for seed in range(count)]
    return tuple(
        Outcome(test_case=case, round=place // 8, ending="completed", robustness=math.sin(place), violated=())
        for place, case in enumerate(cases)
    )


CASES = tuple(layout(seed) for seed in range(4)) + tuple(stimulus(seed) for seed in range(4))
HISTORY = history(max(FLOWN))
