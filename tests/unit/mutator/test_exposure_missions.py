"""The missions that `exposure` draws: what their items say, and what becomes of those of near misses."""

from __future__ import annotations

from collections import Counter

import msgspec
from exposure_cases import TEMPLATE

from saflite.contract.rng import derive
from saflite.contract.test_case import Mission, Scenario, Setting, identity
from saflite.contract.work import Outcome, RuleOutcome
from saflite.flight.autopilots.reference.check import check_test_case
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.scenarios import Rng, scenarios_of
from saflite.mutator.strategies.exposure import Strategy

SCENARIOS = scenarios_of(TEMPLATE.scenario, describe())


def drawn(rng: Rng) -> Mission:
    mission = SCENARIOS.mission(rng).mission
    assert mission is not None
    return mission


def test_a_drawn_mission_holds_nothing_that_the_target_takes_in_none() -> None:
    settings: dict[str, Setting] = {"hints": [], "missions": 1.0, "kept": 0.0, "routed": 0.0}

    def commands(*lacks: int) -> set[int]:
        other = msgspec.structs.replace(describe(), name="other", mission_lacks=lacks)
        drawn = Strategy(TEMPLATE, settings, ("upright",), other).ask(40, derive(1, "test"))
        return {item.command for one in drawn if one.scenario.mission for item in one.scenario.mission.items}

    assert commands() - commands(112, 115) == {112, 115}


def test_drawn_missions_have_items_without_a_place_and_headings_either_way_round() -> None:
    rng = derive(1, "test")
    items = [item for _ in range(60) for item in drawn(rng).items]
    for command in (16, 21, 22):
        places = [item.params[4:6] for item in items if item.command == command]
        assert 0 < places.count((0.0, 0.0)) < len(places) / 2, command
    assert {(item.params[2], item.params[3]) for item in items if item.command == 115} == {
        *((way, 0.0) for way in (-1.0, 0.0, 1.0)),
        *((way, 1.0) for way in (-1.0, 1.0)),
    }


def test_a_drawn_mission_is_changed_by_one_item_and_can_be_flown() -> None:
    rng = derive(2, "test")
    lengths = set()
    for _ in range(100):
        before = drawn(rng)
        after = SCENARIOS.changed(rng, before)
        assert after.name != before.name or after.items == before.items
        lengths.add(len(after.items) - len(before.items))
        assert after.items[0] == before.items[0]
        assert Counter(item.command for item in after.items if item.command in (20, 21)) == Counter(
            item.command for item in before.items if item.command in (20, 21)
        )
        for place, item in enumerate(after.items):
            assert item.command != 177 or (item.params[0] or 0.0) <= place + 2
        check_test_case(msgspec.structs.replace(TEMPLATE, scenario=Scenario(mission=after)))
    assert lengths == {-1, 0, 1}


def test_a_near_miss_of_a_drawn_mission_is_tried_with_other_items() -> None:
    settings: dict[str, Setting] = {"hints": [], "missions": 1.0, "kept": 0.0, "routed": 0.0}
    near = Strategy(TEMPLATE, settings, ("upright",), describe()).ask(1, derive(1, "test"))[0]
    searching = Strategy(TEMPLATE, {**settings, "kept": 1.0}, ("upright",), describe())
    held = RuleOutcome("upright", "held", robustness=0.01)
    near_miss = Outcome(test_case=near, round=0, ending="completed", robustness=0.01, rules=(held,))
    searching.tell([near_miss])
    after = [one for one in searching.ask(40, derive(1, "test")) if one.origin.parent == identity(near)]
    other = [one for one in after if one.scenario.mission != near.scenario.mission]
    assert 0 < len(other) < len(after)
    assert all(one.stimuli == near.stimuli and "item" in one.origin.note for one in other)


def test_a_mission_is_interrupted_several_times_and_gone_on_with() -> None:
    settings: dict[str, Setting] = {
        "hints": [],
        "missions": 1.0,
        "kept": 0.0,
        "routed": 0.0,
        "procedures": ["upright air 20; LOITER; wait 1..2; RC1 1200; wait 2..3; release; wait 1..2"],
    }
    long = msgspec.structs.replace(TEMPLATE, scenario=msgspec.structs.replace(TEMPLATE.scenario, time_limit_s=400.0))
    often: Counter[int] = Counter()
    for case in Strategy(long, settings, ("upright",), describe()).ask(80, derive(6, "test")):
        pushed = [one.at_s for one in case.stimuli if one.name == "RC1" and one.values == (1200.0,)]
        resumed = [one.at_s for one in case.stimuli if one.name == "AUTO"]
        if not case.origin.note.startswith("calm") or not pushed:
            continue
        often[len(pushed)] += 1
        assert not [one for one in case.stimuli if one.name == "LOITER"], "what it gives comes in the mission"
        assert len(pushed) - 1 <= len(resumed) <= len(pushed), "the flight may be over before the last"
        assert all(one < other for one, other in zip(pushed, resumed, strict=False))
    assert set(often) == {1, 2, 3, 4}
