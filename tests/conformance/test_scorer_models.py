"""Every scorer model found by its place: a score in 0..10 per test case, the same whoever asks and in what company."""

from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import pytest

from saflite.contract.rng import derive
from saflite.contract.score import SCORE_MAX, SCORE_MIN
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.work import Outcome
from saflite.flight.mission import builtin_mission
from saflite.scorer_pool.model import Job, Model, PolicyBrief, Tools
from saflite.scorer_pool.registry import describe, make, model_names

SERVED = {"ollama", "openai"}  # need a server: their own tests stand in tests/unit/scorer_pool and tests/live
EMBEDDED = tuple(name for name in model_names() if name not in SERVED)
BRIEFS = (
    PolicyBrief("min-obstacle-distance", "Keep 1.5 m from obstacles.", ("obstacle_distance_m",)),
    PolicyBrief("a-chute", "Deploying a parachute needs armed motors and no FLIP or ACRO mode.", ("chute_released",)),
)


class StillClock:
    def monotonic_s(self) -> float:
        return 0.0

    def unix_s(self) -> float:
        return 0.0


def build(label: str) -> Model:
    made: dict[str, Model] = {}

    def get(name: str) -> Model:
        if name not in made:
            made[name] = make(name, Tools(StillClock(), get))
        return made[name]

    return get(label)


def layout(seed: int) -> TestCase:
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
    rng = derive(seed, "stimulus")
    names = ("MAV_CMD_DO_PARACHUTE", "SIM_GPS_DISABLE", "ATC_RAT_RLL_FF", "UNHEARD_OF")
    stimuli = (
        Stimulus(at_s=1.0, kind="command", name=names[int(rng.integers(4))], values=(float(rng.uniform(-1, 5)),)),
        Stimulus(at_s=2.0, kind="mode", name="ACRO"),
    )
    return TestCase(target=Target(), scenario=Scenario(start=StartState()), stimuli=stimuli, rng_seed=seed)


CASES = tuple(layout(seed) for seed in range(4)) + tuple(stimulus(seed) for seed in range(4))


def history(count: int) -> tuple[Outcome, ...]:
    cases = [layout(100 + seed) if seed % 2 else stimulus(100 + seed) for seed in range(count)]
    return tuple(
        Outcome(test_case=case, round=place // 8, ending="completed", robustness=math.sin(place), violated=())
        for place, case in enumerate(cases)
    )


HISTORY = history(40)


@pytest.mark.parametrize("name", EMBEDDED)
@pytest.mark.parametrize("flown", [0, 40])
class TestEmbedded:
    def job(self, flown: int, cases: tuple[TestCase, ...] = CASES, rng_seed: int = 3) -> Job:
        return Job(cases, BRIEFS, rng_seed, 9, HISTORY[:flown], 5 if flown else -1)

    def test_gives_one_mark_from_0_to_10_per_test_case(self, name: str, flown: int) -> None:
        sheet = build(name).score(self.job(flown))
        assert len(sheet.scores) == len(CASES)
        assert all(SCORE_MIN <= score.value <= SCORE_MAX and not score.fault for score in sheet.scores)
        assert all(score.reason for score in sheet.scores)
        assert sheet.digest

    def test_same_scores_from_another_instance_in_other_company_and_order(self, name: str, flown: int) -> None:
        whole = build(name).score(self.job(flown)).scores
        other = build(name)
        turned = other.score(self.job(flown, CASES[::-1])).scores[::-1]
        alone = tuple(other.score(self.job(flown, (case,))).scores[0] for case in CASES)
        assert [score.value for score in whole] == [score.value for score in turned] == [score.value for score in alone]

    def test_origin_of_a_test_case_does_not_matter(self, name: str, flown: int) -> None:
        renamed = tuple(
            msgspec.structs.replace(case, origin=msgspec.structs.replace(case.origin, strategy="other", round=77))
            for case in CASES
        )
        model = build(name)
        assert model.score(self.job(flown)).scores == model.score(self.job(flown, renamed)).scores

    def test_nothing_asked_nothing_scored(self, name: str, flown: int) -> None:
        assert build(name).score(self.job(flown, ())).scores == ()

    def test_warms_and_closes(self, name: str, flown: int) -> None:
        model = build(name)
        assert model.warm(lambda: False)
        model.close()


@pytest.mark.parametrize("name", model_names())
def test_is_described_in_its_file(name: str) -> None:
    assert len(describe(name).splitlines()[0]) > 20


@pytest.mark.parametrize("name", [name for name in EMBEDDED if name != "constant"])
def test_refuses_an_argument_it_does_not_take(name: str) -> None:
    from saflite.contract.errors import Refused

    with pytest.raises(Refused):
        build(f"{name}:no-such-thing")


def test_random_changes_with_the_seed_and_learning_models_with_what_was_flown() -> None:
    job = Job(CASES, BRIEFS, 1)
    assert build("random").score(job).scores != build("random").score(job._replace(rng_seed=2)).scores
    for name in ("surrogate", "ensemble", "novelty"):
        taught = job._replace(history=HISTORY, cursor=5)
        assert build(name).score(job).scores != build(name).score(taught).scores
    assert all(a != b for a, b in pairwise(score.value for score in build("random").score(job).scores))


def test_surrogate_goes_by_geometry_until_it_has_learnt() -> None:
    few, enough = (Job(CASES, BRIEFS, 1, 9, HISTORY[:count], 5) for count in (15, 16))
    by_geometry = [score.value for score in build("gap").score(few).scores]
    assert [score.value for score in build("surrogate").score(few).scores] == by_geometry
    assert [score.value for score in build("surrogate").score(enough).scores] != by_geometry
