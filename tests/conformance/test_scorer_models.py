"""The suite of scorer models over every embedded one, and what single ones promise besides."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import pytest

from saflite.conformance.kit import Check, findings, name_of
from saflite.conformance.scorers import HISTORY, check_scorer, job, open_model
from saflite.contract.errors import Refused
from saflite.scorer_pool.model import Job, Model, ModelScore, ScoreSheet
from saflite.scorer_pool.registry import describe, model_names

SERVED = {"ollama", "openai"}  # need a server: their own tests stand in tests/unit/scorer_pool and tests/live
EMBEDDED = tuple(name for name in model_names() if name not in SERVED)


@pytest.mark.parametrize(
    ("name", "check"),
    [(name, check) for name in EMBEDDED for check in check_scorer(partial(open_model, name))],
    ids=lambda value: name_of(value) if isinstance(value, Check) else str(value),
)
def test_embedded_models(name: str, check: Check) -> None:
    assert findings([check]) == []


@pytest.mark.parametrize("name", model_names())
def test_is_described_in_its_file(name: str) -> None:
    assert len(describe(name).splitlines()[0]) > 20


@pytest.mark.parametrize("name", [name for name in EMBEDDED if name != "constant"])
def test_refuses_an_argument_it_does_not_take(name: str) -> None:
    with pytest.raises(Refused):
        open_model(f"{name}:no-such-thing")


class Forgetful:
    """A model that scores by the place in the batch, and counts its calls."""

    label, parallel = "forgetful", 1

    def score(self, job: Job) -> ScoreSheet:
        return ScoreSheet(tuple(ModelScore(float(place), "place") for place in range(len(job.test_cases))), digest="f")

    def warm(self, cancelled: object) -> str:
        return "ready"

    def close(self) -> None:
        """Nothing to free."""


def test_a_model_that_goes_by_the_place_in_the_batch_is_found_out() -> None:
    broken: Model = Forgetful()
    found = {one.check.partition("_in_")[0] for one in findings(check_scorer(lambda: broken))}
    assert found == {"same_scores_from_another_instance"}


def test_random_changes_with_the_seed_and_learning_models_with_what_was_flown() -> None:
    asked = job()
    assert open_model("random").score(asked).scores != open_model("random").score(job(rng_seed=2)).scores
    for name in ("surrogate", "ensemble", "novelty"):
        taught = asked._replace(history=HISTORY, cursor=5)
        assert open_model(name).score(asked).scores != open_model(name).score(taught).scores
    assert all(a != b for a, b in pairwise(score.value for score in open_model("random").score(asked).scores))


def test_surrogate_goes_by_geometry_until_it_has_learnt() -> None:
    few, enough = job(15), job(16)
    by_geometry = [score.value for score in open_model("gap").score(few).scores]
    assert [score.value for score in open_model("surrogate").score(few).scores] == by_geometry
    assert [score.value for score in open_model("surrogate").score(enough).scores] != by_geometry
