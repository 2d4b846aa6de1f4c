"""What made a rule apply is given again: recipes, settings pushed the way a comparison asks, orders to leave home."""

from __future__ import annotations

import math

import pytest
from exposure_cases import HAVE, POLICIES, TEMPLATE, case, given

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Setting
from saflite.contract.verdict import Transition
from saflite.contract.work import Outcome, RuleOutcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure import numbers
from saflite.mutator.exposure.attention import Attention, note
from saflite.mutator.exposure.hints import read_hints
from saflite.mutator.exposure.recipes import BEFORE_S, INPUTS_MAX, KEPT, Recipes
from saflite.mutator.operators.commands import HOME_LAT_DEG, HOME_LON_DEG, away
from saflite.mutator.strategies.exposure import Strategy

FLIP = (
    given("mode", "ALT_HOLD", at_s=2.0),
    given("stick", "RC3", 1500.0, at_s=40.0),
    given("mode", "FLIP", at_s=41.0),
    given("parameter", "RTL_ALT", 900.0, at_s=41.5),
    given("mode", "LAND", at_s=50.0),
)


def told(recipes: Recipes, *, flights: int = 1, idle: int = 9) -> None:
    for _ in range(flights):
        recipes.tell(case(*FLIP), {"a-flip1": 42.0}, [0, 1, 2, 4])
    for _ in range(idle):
        recipes.tell(case(*FLIP), {}, [])


def test_a_recipe_holds_what_was_taken_shortly_before_the_rule_applied_and_the_mode_it_began_in() -> None:
    recipes = Recipes({"a-flip1": 3.0})
    assert recipes.draw(derive(1, "test"), "a-flip1") is None
    told(recipes)
    recipe = recipes.draw(derive(1, "test"), "a-flip1")
    assert recipe is not None
    assert recipe.stimuli == FLIP[1:3]
    assert (recipe.mode, recipe.lasted_s) == ("ALT_HOLD", 2.0)


def test_a_rule_that_waits_for_long_has_a_recipe_of_as_long() -> None:
    recipes = Recipes({"a-flip1": 40.0 - BEFORE_S})
    told(recipes)
    recipe = recipes.draw(derive(1, "test"), "a-flip1")
    assert recipe is not None
    assert recipe.stimuli == FLIP[:3]
    assert recipe.mode == "LOITER"  # of the start


def test_a_rule_that_spoke_long_after_the_last_input_has_a_recipe_of_the_last_few() -> None:
    recipes = Recipes({})
    recipes.tell(case(*FLIP), {"return-ends-at-home": 120.0}, range(5))
    for _ in range(9):
        recipes.tell(case(), {}, [])
    recipe = recipes.draw(derive(1, "test"), "return-ends-at-home")
    assert recipe is not None
    assert (recipe.stimuli, recipe.lasted_s) == (FLIP[-3:], 79.0)


def test_only_the_latest_recipes_are_kept_and_none_are_long() -> None:
    recipes = Recipes({})
    many = [given("stick", "RC3", 1000.0 + number, at_s=1.0 + 0.1 * number) for number in range(3 * INPUTS_MAX)]
    for number in range(3 * KEPT):
        recipes.tell(case(*many[number:]), {"p": 10.0}, range(len(many) - number))
    recipes.tell(case(), {"p": 10.0}, [])  # applied without any input: nothing to give again
    for _ in range(90):
        recipes.tell(case(), {}, [])
    drawn = [recipes.draw(derive(seed, "test"), "p") for seed in range(100)]
    assert {len(one.stimuli) for one in drawn if one is not None} <= set(range(1, INPUTS_MAX + 1))
    assert len({one.stimuli for one in drawn if one is not None}) <= KEPT


def test_a_rule_that_applies_in_many_flights_needs_no_recipe() -> None:
    recipes = Recipes({"a-flip1": 3.0})
    told(recipes, flights=5, idle=5)
    assert recipes.draw(derive(1, "test"), "a-flip1") is None


def test_fresh_test_cases_give_a_recipe_again_with_something_changed() -> None:
    hints: list[str] = ["a-rtl1 start:LOITER@20 quiet:5"]

    def again(recalled: float) -> int:
        settings: dict[str, Setting] = {"hints": list(hints), "kept": 0.0, "routed": 0.0, "recalled": recalled}
        searching = Strategy(TEMPLATE, settings, ("a-rtl1",), describe())
        steps = tuple(Transition("LOITER", "LOITER", place, place - 1) for place in range(len(FLIP)))
        for rules in ((RuleOutcome("a-rtl1", "held", 1.0, 0.5, 42.0),), (), (), ()):
            flown = Outcome(
                test_case=case(*FLIP), round=0, ending="completed", robustness=None, rules=rules, transitions=steps
            )
            searching.tell([flown])
        names = [[one.name for one in made.stimuli] for made in searching.ask(40, derive(1, "ask"))]
        return sum("FLIP" in one and "RC3" in one for one in names)

    assert again(1.0) > 30
    assert again(1.0) > 2 * again(0.0)


def test_attention_turns_to_rules_that_seldom_apply() -> None:
    attention = Attention(POLICIES)
    for _ in range(80):
        attention.tell(case(text=note((), "fresh")), {"upright": 0.6})
    drawn = attention.rotation(derive(1, "test"), 300)
    assert drawn.count("upright") * 3 < drawn.count("a-chute")
    assert drawn.count("upright") > 20


def test_settings_are_pushed_up_or_down_within_their_range() -> None:
    (hint,) = read_hints(["a-rtl1 pushes:FENCE_ALT_MAX=-1 pushes:RTL_ALT=1 far:30"], ("a-rtl1",), HAVE)
    assert [(entry.name, sense) for entry, sense in hint.pushed] == [("FENCE_ALT_MAX", -1.0), ("RTL_ALT", 1.0)]
    assert hint.far_m == 30.0
    rng = derive(1, "test")
    for entry, sense in hint.pushed:
        drawn = [numbers.pushed(rng, entry, 100.0, sense) for _ in range(200)]
        assert all(entry.low <= value <= entry.high and sense * (value - 100.0) > 0 for value in drawn)
        assert len(set(drawn)) > 50
    with pytest.raises(Refused):
        read_hints(["a-rtl1 far:soon"], ("a-rtl1",), HAVE)
    with pytest.raises(Refused):
        read_hints(["a-rtl1 pushes:NO_SUCH=1"], ("a-rtl1",), HAVE)


def test_a_setting_without_range_or_default_is_pushed_all_the_same() -> None:
    entry = HAVE["parameter", "RTL_ALT"]
    rng = derive(1, "test")
    assert numbers.pushed(rng, entry._replace(low=math.nan, high=math.nan), 100.0, -1.0) < 100.0
    assert math.isfinite(numbers.pushed(rng, entry._replace(low=math.nan, high=math.nan), None, 1.0))
    assert entry.low <= numbers.pushed(rng, entry, None, -1.0) <= entry.high


def test_an_order_to_leave_home_leads_as_far_as_asked() -> None:
    rng = derive(1, "test")
    for _ in range(100):
        *_, lat, lon, height_m = away(rng, 30.0, 12.0)
        north = (lat - HOME_LAT_DEG) * 111_320.0
        east = (lon - HOME_LON_DEG) * 111_320.0 * math.cos(math.radians(HOME_LAT_DEG))
        assert 35.0 < math.hypot(north, east) < 361.0
        assert height_m == 12.0


def test_a_rule_about_a_lost_sensor_gets_faults_of_its_own_and_settings_it_reads_are_off_their_default() -> None:
    hint = "a-rtl1 start:LOITER@20 upset: quiet:5 reads:parameter:RTL_ALT sensor_fault:SIM_GPS_DISABLE mode:RTL"

    def with_it(text: str, kind: str, name: str) -> int:
        settings: dict[str, Setting] = {"hints": [text], "kept": 0.0, "routed": 0.0, "own": 0.0, "phases_max": 1}
        searching = Strategy(TEMPLATE, settings, ("a-rtl1",), describe())
        return sum(
            any((one.kind, one.name) == (kind, name) for one in made.stimuli)
            for made in searching.ask(60, derive(1, "ask"))
        )

    assert with_it(hint, "sensor_fault", "SIM_GPS_DISABLE") > 20
    assert with_it(hint.replace(" upset:", ""), "sensor_fault", "SIM_GPS_DISABLE") < 10
    assert with_it(hint, "parameter", "RTL_ALT") > 15
    assert with_it(hint.replace(" reads:parameter:RTL_ALT", ""), "parameter", "RTL_ALT") < 10
