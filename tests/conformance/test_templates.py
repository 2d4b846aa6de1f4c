"""What `saflite new` writes works as it is, and what the pages on one's own parts show is what it writes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import load_campaign
from saflite.conformance.kit import findings
from saflite.conformance.scorers import StillClock, check_scorer
from saflite.conformance.scorers import open_model as open_shipped
from saflite.conformance.strategies import Setup, check_strategy
from saflite.conformance.targets import checks_of
from saflite.console.cli import command_names
from saflite.console.commands.new import KINDS
from saflite.console.io import campaign_options
from saflite.console.operations import beginning
from saflite.contract import modules
from saflite.contract.errors import Refused
from saflite.flight.autopilots.described import default_target
from saflite.mutator.registry import load_strategy
from saflite.oracle.policy import load_policy
from saflite.scorer_pool.model import Tools
from saflite.simulator_worker.registry import load_target

pytestmark = pytest.mark.usefixtures("no_modules")
DOCS = Path(__file__).parents[2] / "deploy" / "docs"


@pytest.fixture
def no_modules() -> Iterator[None]:
    yield
    modules.forget()


def written(kind: str, name: str, folder: Path) -> list[Path]:
    return beginning.begin(kind, name, folder, force=False)


def test_the_policy_is_read_and_can_be_searched(tmp_path: Path) -> None:
    (path,) = written("policy", "stays-below", tmp_path)
    assert load_policy(str(path)).id == "stays-below"
    campaign_options.check_runnable(load_campaign(str(path)))


def test_the_campaign_can_be_run(tmp_path: Path) -> None:
    (path,) = written("campaign", "tips-over", tmp_path)
    campaign = load_campaign(str(path))
    assert campaign.name == "tips-over"
    campaign_options.check_runnable(campaign)


def test_the_strategy_passes_its_suite(tmp_path: Path) -> None:
    (path,) = written("strategy", "my_strategy", tmp_path)
    modules.use([path])
    assert findings(check_strategy(Setup("my_strategy", load_strategy("my_strategy"), default_target()))) == []


def test_the_scorer_passes_its_suite(tmp_path: Path) -> None:
    (path,) = written("scorer", "my_scorer", tmp_path)
    module = modules.load_file(path)
    assert findings(check_scorer(lambda: module.Model("", Tools(StillClock(), open_shipped)))) == []


def test_the_target_passes_its_suite_and_its_campaign_can_be_run(tmp_path: Path) -> None:
    module, policy, campaign = written("target", "my_vehicle", tmp_path)
    modules.use([module])
    assert findings(checks_of(load_target("my_vehicle"))) == []
    assert load_policy(str(policy)).id == "my-vehicle-stays"
    campaign_options.check_runnable(load_campaign(str(campaign)))


def test_nothing_is_written_over_and_bad_names_are_refused(tmp_path: Path) -> None:
    written("target", "my_vehicle", tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for kind, name in (("target", "my_vehicle"), ("policy", "my_vehicle"), ("strategy", "a-b"), ("policy", "upright")):
        with pytest.raises(Refused):
            written(kind, name, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_a_page_whose_commands_exist(kind: str) -> None:
    text = (DOCS / f"own-{kind}.md").read_text()
    assert f"saflite new {kind} " in text
    used = set(re.findall(r"^ {4}saflite ([a-z]+)", text, re.MULTILINE))
    assert used <= set(command_names())
    for after in beginning.after(kind, "x"):
        assert after.split()[1] in command_names()
