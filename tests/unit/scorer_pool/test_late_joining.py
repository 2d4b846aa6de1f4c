"""A scorer that was there from the beginning and one that came late give bit-equal scores, whatever the model."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.work import Outcome, ScoreResult, ScoreWork
from saflite.flight.mission import builtin_mission
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.model import PolicyBrief
from saflite.scorer_pool.work import ScorerPool

ROUNDS, EACH, SINCE = 26, 4, 15
MISSION = builtin_mission("mission2")


def _layout(rng: np.random.Generator) -> TestCase:
    boxes = tuple(
        Obstacle(
            length_m=5.0,
            width_m=5.0,
            height_m=20.0,
            x_m=float(rng.uniform(-30, 30)),
            y_m=float(rng.uniform(10, 40)),
        )
        for _ in range(2)
    )
    return TestCase(target=Target(), scenario=Scenario(mission=MISSION, obstacles=boxes))


def _inputs(rng: np.random.Generator) -> TestCase:
    stimuli = tuple(
        Stimulus(at_s=float(place), kind="parameter", name=f"P{rng.integers(6)}", values=(1.0,)) for place in range(3)
    )
    return TestCase(
        target=Target(), scenario=Scenario(start=StartState(mode="GUIDED", altitude_m=30.0)), stimuli=stimuli
    )


def _outcome(rng: np.random.Generator, case: TestCase, round_: int) -> Outcome:
    """Early flights tell the opposite of late ones: who remembers them scores otherwise."""
    boxes = case.scenario.obstacles
    place = boxes[0].x_m / 10.0 if boxes else 2.0 * sum(one.name == "P3" for one in case.stimuli) - 1.0
    robustness = float((place if round_ > SINCE else -place) + 0.1 * rng.normal())
    return Outcome(
        test_case=case, round=round_, ending="completed", robustness=robustness, violated=("p",) if place < 0 else ()
    )


@pytest.mark.parametrize(
    ("made", "model"),
    [
        *((_layout, model) for model in ("surrogate", "ensemble", "blend", "novelty")),
        *((_inputs, model) for model in ("surrogate", "ensemble", "blend", "relevance", "novelty")),
    ],
)
def test_told_from_the_beginning_or_late(made: Callable[[np.random.Generator], TestCase], model: str) -> None:
    rng = derive(1, "late")
    rounds = [tuple(_outcome(rng, made(rng), number) for _ in range(EACH)) for number in range(ROUNDS)]
    batch = ScoreWork(
        round=ROUNDS + 2,
        model=model,
        shadow=(),
        policies=("p",),
        test_cases=tuple(made(rng) for _ in range(8)),
        rng_seed=5,
    )
    old, late = (ScorerPool(lambda name, texts: PolicyBrief(name, "words"), WallClock()) for _ in range(2))

    def scored(pool: ScorerPool, from_cursor: int, cursor: int, first: int, since: int) -> ScoreResult:
        recent = tuple(outcome for number in range(first, cursor + 1) for outcome in rounds[number])
        told = {"recent": recent, "from_cursor": from_cursor, "cursor": cursor, "since": since}
        result = pool.do(msgspec.structs.replace(batch, **told), lambda: False)
        assert isinstance(result, ScoreResult)
        return result

    for number in range(ROUNDS - 1):  # scoring on the way, so that whatever a model keeps is kept
        scored(old, number - 1, number, number, max(-1, number - ROUNDS + 1 + SINCE))
    there = scored(old, ROUNDS - 2, ROUNDS - 1, ROUNDS - 1, SINCE)
    joined = scored(late, -1, ROUNDS - 1, SINCE + 1, SINCE)
    assert there.scores == joined.scores
    assert len({score.value for score in there.scores}) > 1
