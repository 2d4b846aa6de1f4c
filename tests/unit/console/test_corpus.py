"""Beginning with what an earlier run kept; a run of another build is refused in words."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.run_data.corpus import with_corpus
from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference.describe import describe


@pytest.fixture
def run(tmp_path: Path) -> Path:
    campaign = load_campaign("policy-a-chute")
    Store.create(tmp_path / "run", campaign, template(campaign), describe()).close()
    return tmp_path / "run"


def test_a_run_of_the_same_build_is_taken(run: Path) -> None:
    campaign = with_corpus(load_campaign("policy-a-chute"), run, describe())
    assert campaign.strategy.settings["corpus"] == []


def test_a_run_of_another_build_or_target_is_refused(run: Path) -> None:
    for other in ({"build": "f" * 64}, {"name": "betaflight"}):
        target = msgspec.structs.replace(describe(), **other)
        with pytest.raises(Refused, match=r"corpus .*expected flights of .*, build .*begin without --corpus"):
            with_corpus(load_campaign("policy-a-chute"), run, target)


def test_a_strategy_without_corpus_is_refused(run: Path) -> None:
    with pytest.raises(Refused, match="strategy exposure"):
        with_corpus(load_campaign("avoidance-m2"), run, describe())
