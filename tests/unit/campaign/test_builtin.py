"""Built-in campaigns load, name things that exist, and bad campaign files are refused in one line."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import builtin_campaigns, load_campaign, template
from saflite.campaign.presets.policy_campaigns import ALL, policy_campaign
from saflite.console import templates
from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import StartState
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.mission import builtin_mission, dump_plan, waypoints
from saflite.mutator.registry import load_strategy
from saflite.oracle.policy import load_policy, policy_names
from saflite.scorer_pool.registry import check_label
from saflite.simulator_worker.registry import load_target, why_missing

TEMPLATES = Path(templates.__file__).parent
TOLD = builtin_campaigns()
NAMES = sorted(TOLD)


def test_missions_one_to_seven_are_there_and_stand_ins_say_so() -> None:
    campaigns = builtin_campaigns()
    for number in range(1, 8):
        text = campaigns[f"avoidance-m{number}"]
        assert ("stand-in" in text) == (number >= 6)


@pytest.mark.parametrize("name", NAMES)
def test_a_built_in_campaign_can_be_run_as_it_stands(name: str) -> None:
    campaign = load_campaign(name)
    assert campaign.name == name
    assert campaign.description == TOLD[name]
    check_label(campaign.scorer.model)
    for policy in campaign.policies:
        load_policy(policy)
    case = template(campaign)
    if why_missing(case.target.name):
        pytest.skip(f"{case.target.name}: {why_missing(case.target.name)}")
    target = load_target(case.target.name)
    target.check(case)
    make = load_strategy(campaign.strategy.name)
    strategy = make(case, dict(campaign.strategy.settings), campaign.policies, target.describe())
    for proposed in strategy.ask(20, derive(1, name)):
        target.check(proposed)
    assert case.rng_seed == campaign.rng_seed
    assert (case.scenario.mission is None) != (case.scenario.start is None)
    if case.scenario.mission is not None:
        assert waypoints(case.scenario.mission)


@pytest.mark.parametrize("name", ["reference", "ardupilot", "px4"])
def test_all_rules_that_fit_a_target_can_be_searched_there_with_their_procedures(name: str) -> None:
    if why_missing(name):
        pytest.skip(f"{name}: {why_missing(name)}")
    target = load_target(name)
    campaign = policy_campaign(ALL, target.describe())
    assert campaign is not None
    settings = {**campaign.strategy.settings, "followed": 1.0}
    strategy = load_strategy(campaign.strategy.name)(template(campaign), settings, campaign.policies, target.describe())
    for proposed in strategy.ask(40, derive(1, name)):
        target.check(proposed)


def test_a_rule_about_missions_is_searched_on_many_missions_and_on_its_campaigns_own() -> None:
    campaign = load_campaign("policy-mission-in-order")
    own, target = template(campaign), load_target("reference").describe()
    strategy = load_strategy(campaign.strategy.name)(own, dict(campaign.strategy.settings), campaign.policies, target)
    flown = [one.scenario.mission for one in strategy.ask(40, derive(1, "missions"))]
    assert own.scenario.mission in flown
    drawn = [one for one in flown if one is not None and one != own.scenario.mission]
    assert len({one.name for one in drawn}) > 20
    assert {item.command for one in drawn for item in one.items} > {16, 17, 19, 20, 21, 22, 82, 112, 115, 177, 178}


@pytest.mark.parametrize(("policy", "flies_missions"), [("order-taken", True), ("stick-scale", False)])
def test_a_rule_that_holds_in_missions_too_is_searched_on_some(policy: str, *, flies_missions: bool) -> None:
    campaign, target = load_campaign(f"policy-{policy}"), load_target("reference").describe()
    make = load_strategy(campaign.strategy.name)
    strategy = make(template(campaign), dict(campaign.strategy.settings), campaign.policies, target)
    flown = [one.scenario.mission is not None for one in strategy.ask(100, derive(1, policy))]
    assert (0 < sum(flown) < 30) is flies_missions


@pytest.mark.parametrize("name", ["avoidance-m9", "", "../builtin/avoidance-m1", "nonsense.toml"])
def test_an_unknown_campaign_is_refused(name: str) -> None:
    with pytest.raises(Refused, match="campaign"):
        load_campaign(name)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("name = ", "TOML"),
        ('description = "x"', "name"),
        ('name = "x"\nbudget = 3', "budget"),
        ('name = "x"\nmission = "mission1"\nbudget_flights = -5', "budget_flights"),
        ('name = "x y"\nmission = "mission1"', "campaign name"),
    ],
)
def test_a_bad_campaign_file_is_refused(tmp_path: Path, text: str, word: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(Refused, match=word):
        load_campaign(str(file))


@pytest.mark.parametrize(
    ("text", "name", "word"),
    [
        ('policies = ["upright", "upright"]', "policies", "upright"),
        ('[scorer]\nshadow = ["gap", "chance", "gap"]', "scorer.shadow", "gap"),
        ('[scorer]\nguests = ["far-*", "far-*"]', "scorer.guests", "far-*"),
        ('[target.settings]\ndefects = ["late", "late"]', "target.settings.defects", "late"),
        ('[strategy.settings]\narms = ["pgfuzz", "pgfuzz"]', "strategy.settings.arms", "pgfuzz"),
        ('[strategy.settings]\nparameters = ["A", "B", "B"]', "strategy.settings.parameters", "B"),
        ('policies = ["one.toml", "two.toml"]', "policies", "stays-below"),
    ],
)
def test_what_stands_twice_in_a_list_is_refused_by_name(tmp_path: Path, text: str, name: str, word: str) -> None:
    policy = (TEMPLATES / "policy.toml").read_text().replace("NAME", "stays-below")
    for file in ("one.toml", "two.toml"):
        (tmp_path / file).write_text(policy)
    (tmp_path / "mine.toml").write_text(f'name = "x"\nmission = "mission1"\n{text}')
    with pytest.raises(Refused, match=rf"{re.escape(name)}.*each once.*'{re.escape(word)}' twice"):
        load_campaign(str(tmp_path / "mine.toml"))


def test_a_plan_is_looked_for_beside_the_campaign_file(tmp_path: Path) -> None:
    (tmp_path / "site.plan").write_text(dump_plan(builtin_mission("mission3")))
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\nmission = "site.plan"')
    mission = template(load_campaign(str(file))).scenario.mission
    assert mission is not None
    assert mission.items == builtin_mission("mission3").items


@pytest.mark.parametrize("text", ['mission = ""', 'mission = "mission1"\n[start]\nmode = "LOITER"'])
def test_a_campaign_needs_a_mission_or_a_start(tmp_path: Path, text: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'name = "mine"\n{text}')
    with pytest.raises(Refused, match="one of them"):
        template(load_campaign(str(file)))


def test_a_campaign_can_begin_in_a_start_state(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\n[start]\nmode = "LOITER"\naltitude_m = 30')
    assert template(load_campaign(str(file))).scenario.start == StartState(mode="LOITER", altitude_m=30.0)


def test_an_unknown_mission_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\nmission = "mission99"')
    with pytest.raises(Refused, match="mission99"):
        template(load_campaign(str(file)))


def test_every_policy_the_reference_can_break_has_a_campaign() -> None:
    for policy in policy_names():
        file = load_policy(policy).file
        has_inputs = any((file.inputs.parameters, file.inputs.commands, file.inputs.sticks, file.inputs.modes))
        expected = has_inputs and "reference" not in file.not_checked_on
        assert (f"policy-{policy}" in NAMES) == expected, policy
    assert "policy-a-chute" in NAMES
    everything = load_campaign("policy-all")
    single = {name.removeprefix("policy-") for name in NAMES if name.startswith("policy-")} - {"autopilot-alive", "all"}
    rules = [str(load_policy(policy).formula) for policy in everything.policies]
    assert set(rules) == {str(load_policy(policy).formula) for policy in single}
    assert len(rules) == len(set(rules)), "each rule once, however many published policies ask for it"
    assert set(everything.policies) <= single


def test_a_policy_campaign_takes_start_inputs_and_preconditions_from_the_policy_file() -> None:
    campaign = load_campaign("policy-a-chute")
    file = load_policy("a-chute").file
    assert campaign.start == file.start
    assert campaign.target.parameters == file.preconditions
    hints = campaign.strategy.settings["hints"]
    assert isinstance(hints, list)
    assert set(str(hints[0]).split()) >= {
        "a-chute",
        "start:ALT_HOLD@50",
        *(f"command:{name}" for name in file.inputs.commands),
    }
    assert campaign.search.shrink


def test_the_campaign_of_a_rule_is_lent_procedures_of_others_about_its_modes() -> None:
    campaign = policy_campaign("policy-a-brake1", describe())
    assert campaign is not None
    others = [str(text) for text in campaign.strategy.settings["others"]]  # type: ignore[union-attr]
    assert others
    assert all("BRAKE" in re.split(r"[\s;|?]+", text) for text in others)
    assert not any(text.startswith("a-brake1 ") for text in others)
    every = policy_campaign("policy-all", describe())
    assert every is not None
    assert "others" not in every.strategy.settings


def test_a_target_from_outside_is_lent_procedures_of_rules_that_are_checked_on_it_alone() -> None:
    elsewhere = policy_campaign("policy-a-brake1", msgspec.structs.replace(describe(), name="ardupilot"))
    assert elsewhere is not None
    lent = {str(text).split()[0] for text in elsewhere.strategy.settings["others"]}  # type: ignore[union-attr]
    assert lent
    assert not [name for name in lent if "ardupilot" in load_policy(name).file.not_checked_on]
