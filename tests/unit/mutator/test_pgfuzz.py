"""PGFuzz's lists, value rules and guidance, with the published dead branches mended."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise

import msgspec
import pytest

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import (
    Origin,
    Scenario,
    Setting,
    StartState,
    Stimulus,
    StimulusKind,
    Target,
    TestCase,
    identity,
)
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.operators import inputs, sequences, values
from saflite.mutator.operators.commands import HOME_LAT_DEG
from saflite.mutator.operators.inputs import Input
from saflite.mutator.operators.sequences import Rhythm
from saflite.mutator.strategies.pgfuzz import Strategy, closeness

TEMPLATE = TestCase(target=Target(), scenario=Scenario(start=StartState(), time_limit_s=60.0))
OWN: dict[str, Setting] = {
    "commands": ["MAV_CMD_DO_PARACHUTE"],
    "modes": ["ACRO", "FLIP"],
    "parameters": ["CHUTE_ENABLED"],
}
SLACK = {f"RC{number}": 1500.0 for number in (1, 2, 3, 4)}
RHYTHM = Rhythm(start_s=1.0, round_s=4.0, bursts=0.3, release=0.7, last_s=52.0, steps_max=6, rest=SLACK)


def outcome(stimuli: tuple[Stimulus, ...], robustness: float, parent: str = "") -> Outcome:
    case = msgspec.structs.replace(TEMPLATE, stimuli=stimuli, origin=Origin(parent=parent))
    violated = ("a-chute",) if robustness < 0 else ()
    return Outcome(test_case=case, round=0, ending="completed", robustness=robustness, violated=violated)


def stimulus(name: str, *numbers: float, kind: StimulusKind = "parameter", at_s: float = 1.0) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=numbers)


# ---- lists --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("policy", "total"), [("A.FLIP1", 231), ("A.CHUTE", 228), ("A.CIRCLE1", 94), ("PX.GPS.FS1", 93), ("PX.ORBIT6", 49)]
)
def test_published_lists_have_their_published_length(policy: str, total: int) -> None:
    """Unique inputs of the published lists (modes by number and sticks counted as one input each)."""
    assert len(inputs.published_inputs(policy)) == total


def test_forty_nine_published_lists() -> None:
    assert len(inputs.published_policies()) == 49
    with pytest.raises(Refused, match=r"A\.CHUTE"):
        inputs.published_inputs("A.PARACHUTE")


def test_what_the_target_does_not_have_is_left_out() -> None:
    have = inputs.target_inputs(describe(), {})
    here = inputs.on_target(inputs.published_inputs("A.CHUTE"), have)
    assert 80 < len(here) < 228
    assert {entry.kind for entry in here} == {"parameter", "command", "stick", "mode", "sensor_fault"}
    assert all(entry == have[(entry.kind, entry.name)] for entry in here)


def test_inputs_are_named_as_in_the_lists() -> None:
    have = inputs.target_inputs(describe(), {})
    modes = inputs.named("command", ["Flight_Mode"], have, "commands")
    assert {entry.kind for entry in modes} == {"mode"}
    assert inputs.named("command", ["RC3"], have, "commands")[0].kind == "stick"
    with pytest.raises(Refused, match="NO_SUCH"):
        inputs.named("parameter", ["NO_SUCH"], have, "parameters")
    with pytest.raises(Refused, match="it has none"):
        inputs.named("parameter", ["RTL_ALT"], {}, "parameters")


# ---- a target of another kind -------------------------------------------------------------------------------------

MASS = TargetInfo(
    name="mass",
    build="1",
    repeats="bitwise",
    inputs=(
        InputInfo(kind="parameter", name="DRAG", unit="1/s", low=0.0, high=2.0, default=0.1),
        InputInfo(kind="parameter", name="GEAR", type="choice", choices=(3.0, 5.0, 8.0)),
        InputInfo(kind="parameter", name="LAMP", type="flag"),
        InputInfo(kind="command", name="JUMP", unit="m", low=1.0, high=4.0),
        InputInfo(kind="stick", name="PUSH", unit="N", low=-1.0, high=1.0, default=0.0),
        InputInfo(kind="stick", name="BRAKE", low=0.0, high=1.0),
    ),
    signals=("x_m",),
)


def test_a_target_of_another_kind_is_given_its_own_inputs_in_its_own_units() -> None:
    strategy = Strategy(TEMPLATE, {"beyond": 0.0, "echoed": 0.0, "release": 1.0}, (), MASS)
    given = [one for case in strategy.ask(200, derive(1, "mass")) for one in case.stimuli]
    values_of: dict[str, set[float]] = {}
    for one in given:
        assert len(one.values) == 1, f"{one.name} takes one number"
        values_of.setdefault(one.name, set()).add(one.values[0])
    assert set(values_of) == {entry.name for entry in MASS.inputs}
    assert values_of["GEAR"] == {3.0, 5.0, 8.0}
    assert values_of["LAMP"] == {0.0, 1.0}
    assert all(0.0 <= value <= 2.0 for value in values_of["DRAG"])
    assert all(1.0 <= value <= 4.0 for value in values_of["JUMP"])
    assert all(-1.0 <= value <= 1.0 for value in values_of["PUSH"])
    assert any(not value.is_integer() for value in values_of["PUSH"])
    assert 0.0 in values_of["PUSH"], "it is let go to its own rest"
    wild = Strategy(TEMPLATE, {"beyond": 1.0}, (), MASS).ask(200, derive(1, "wild"))
    pushes = [one.values[0] for case in wild for one in case.stimuli if one.name == "PUSH"]
    assert min(pushes) < -1.0
    assert max(pushes) > 1.0


def test_nothing_leaves_its_range_where_nothing_may() -> None:
    """A parameter that echoes another's value, or a value moved a little, met no range."""
    strategy = Strategy(TEMPLATE, {"beyond": 0.0, "echoed": 1.0}, (), MASS)
    given = [one for case in strategy.ask(300, derive(2, "mass")) for one in case.stimuli]
    values_of = {entry.name: [one.values[0] for one in given if one.name == entry.name] for entry in MASS.inputs}
    assert set(values_of["GEAR"]) == {3.0, 5.0, 8.0}
    assert max(values_of["DRAG"]) == 2.0, "an echo of a gear is cut to the range"
    moved = values.within(Input("stick", "PUSH", -1.0, 1.0), (1.3,))
    assert moved == (1.0,)
    assert values.within(Input("parameter", "TEETH", 2.0, 9.0, whole=True), (4.6,)) == (5.0,)
    assert values.within(Input("parameter", "FREE"), (77.5,)) == (77.5,)


def test_a_target_without_inputs_is_refused() -> None:
    with pytest.raises(Refused, match="mass, which has none"):
        Strategy(TEMPLATE, {}, (), msgspec.structs.replace(MASS, inputs=()))


# ---- values -------------------------------------------------------------------------------------------------------


def drawn(entry: Input, beyond: float, count: int = 400) -> list[float]:
    rng = derive(1, entry.name, count)
    return [values.draw(rng, entry, beyond)[0] for _ in range(count)]


def test_values_stay_in_the_valid_range_unless_told_otherwise() -> None:
    entry = Input("parameter", "X", 2.0, 5.0)
    within = drawn(entry, 0.0)
    assert all(2.0 <= value <= 5.0 for value in within)
    assert {2.0, 5.0} <= set(within), "the ends are tried"
    assert len(set(within)) > 200


def test_whole_numbers_are_whole() -> None:
    assert all(value.is_integer() for value in drawn(Input("parameter", "X", 0.0, 9.0, whole=True), 0.0))


def test_values_beyond_the_range_are_low_high_negative_and_nought() -> None:
    beyond = drawn(Input("parameter", "COM_POS_FS_DELAY", 1.0, 100.0), 1.0)
    assert -1.0 in beyond, "the value behind three published bugs"
    assert 0.0 in beyond
    assert max(beyond) > 100.0
    assert min(beyond) < -1.0
    assert all(math.isfinite(value) for value in beyond)


def test_inputs_without_bounds_are_not_stuck_at_nought() -> None:
    free = drawn(Input("parameter", "GND_ALT_OFFSET"), 0.0)
    assert 0.02 < free.count(0.0) / len(free) < 0.25
    assert min(free) < -100.0
    assert max(free) > 300.0
    assert any(0 < abs(value) < 0.1 for value in free)


def test_a_least_value_only_reaches_up_to_ten_thousand() -> None:
    half = drawn(Input("parameter", "X", low=0.5), 0.0)
    assert all(0.5 <= value <= 10_000 for value in half)
    assert max(half) > 5_000


def test_commands_get_seven_numbers_and_those_that_mean_something() -> None:
    rng = derive(1, "commands")
    parachute = [values.draw(rng, Input("command", "MAV_CMD_DO_PARACHUTE"), 0.2) for _ in range(200)]
    assert {len(numbers) for numbers in parachute} == {7}
    assert sum(numbers[0] == 2.0 for numbers in parachute) > 60, "2 releases"
    places = [values.draw(rng, Input("command", "MAV_CMD_DO_REPOSITION"), 0.2) for _ in range(50)]
    assert all(abs(numbers[4] - HOME_LAT_DEG) < 0.001 for numbers in places)
    landings = [values.draw(rng, Input("command", "MAV_CMD_NAV_LAND"), 0.2) for _ in range(50)]
    assert 5 < sum(numbers[4] == 0.0 for numbers in landings) < 30, "0 is where the vehicle is"
    assert any(min(numbers) < 0 for numbers in parachute)


def test_sticks_and_heights_go_beyond_as_a_share_of_draws() -> None:
    stick = inputs.target_inputs(describe(), {})["stick", "RC3"]
    assert all(1000.0 <= pulse <= 2000.0 for pulse in drawn(stick, 0.0))
    beyond = drawn(stick, 0.4)
    assert min(beyond) < 975.0, "a throttle below FS_THR_VALUE: the radio failsafe"
    assert all(800.0 <= pulse <= 2200.0 for pulse in beyond)
    rng = derive(1, "heights")
    heights = [values.draw(rng, Input("command", "MAV_CMD_NAV_TAKEOFF"), 0.2)[6] for _ in range(200)]
    assert 0.04 < sum(height < 0 for height in heights) / 200 < 0.2, "a take-off to a negative height"


def test_a_little_change_stays_close() -> None:
    rng, entry = derive(1, "jitter"), Input("parameter", "X", 0.0, 10.0)
    moved = [values.jitter(rng, entry, (5.0,))[0] for _ in range(100)]
    assert all(4.0 <= value <= 6.0 for value in moved)
    assert len(set(moved)) > 50
    chute = Input("command", "MAV_CMD_DO_PARACHUTE")
    before = (2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(50):
        after = values.jitter(rng, chute, before)
        assert sum(a != b for a, b in zip(before, after, strict=True)) <= 1
    assert values.jitter(rng, Input("mode", "ACRO"), ()) == ()


# ---- sequences ----------------------------------------------------------------------------------------------------


def test_sequences_come_in_rounds_and_bursts_and_let_sticks_go() -> None:
    rng = derive(1, "fresh")
    made = [sequences.fresh(rng, lambda _: stimulus("RC3", 1900.0, kind="stick"), 4, RHYTHM) for _ in range(100)]
    assert all(list(each) == sorted(each, key=lambda one: one.at_s) for each in made)
    assert {sequences.steps(each, RHYTHM) for each in made} == {4}
    let_go = sum(len(each) - 4 for each in made) / 400
    assert let_go == pytest.approx(0.7, abs=0.08)
    pushes = [[one.at_s for one in each if one.values == (1900.0,)] for each in made]
    pauses = [later - sooner for times in pushes for sooner, later in pairwise(times)]
    assert sum(pause < 2.01 for pause in pauses) / len(pauses) == pytest.approx(0.3, abs=0.08)
    assert max(pauses) == pytest.approx(4.0)


def test_changes_leave_the_parent_as_it_is_and_keep_the_time_limit() -> None:
    rng = derive(1, "changes")
    parent = (stimulus("A", 1.0), stimulus("B", 2.0, at_s=51.0))

    def draw(_: object) -> Stimulus:
        return stimulus("NEW", 3.0)

    for _ in range(50):
        added = sequences.add(rng, parent, draw, RHYTHM)
        assert Counter(one.name for one in added) == {"A": 1, "B": 1, "NEW": 1}
        replaced = sequences.replace(rng, parent, draw, RHYTHM)
        assert len(replaced) == 2
        assert "NEW" in {one.name for one in replaced}
        dropped = sequences.drop(rng, parent)
        assert len(dropped) == 1
        retimed = sequences.retime(rng, parent, RHYTHM)
        for each in (added, replaced, dropped, retimed):
            assert all(0.0 <= one.at_s <= RHYTHM.last_s for one in each)
    assert parent == (stimulus("A", 1.0), stimulus("B", 2.0, at_s=51.0))


def test_inputs_are_added_before_as_well_as_after_what_is_there() -> None:
    rng = derive(1, "add")
    parent = (stimulus("A", 1.0, at_s=20.0),)
    gaps = [
        one.at_s - 20.0
        for _ in range(200)
        for one in sequences.add(rng, parent, lambda _: stimulus("NEW", 3.0), RHYTHM)
        if one.name == "NEW"
    ]
    assert sum(gap < 0 for gap in gaps) > 40
    assert sum(-2.0 <= gap < 0 for gap in gaps) > 10, "soon before"
    assert sum(gap > 0 for gap in gaps) > 80


def test_an_echo_gives_one_parameter_the_value_of_another() -> None:
    rng = derive(1, "echo")
    parent = (stimulus("A", 1.0), stimulus("RTL", kind="mode"), stimulus("B", 2.0, at_s=9.0))
    found = {tuple(one.values for one in sequences.echo(rng, parent)) for _ in range(50)}
    assert found == {((1.0,), (), (1.0,)), ((2.0,), (), (2.0,))}
    alone = (stimulus("A", 1.0), stimulus("A", 2.0, at_s=9.0))
    assert sequences.echo(rng, alone) == alone, "one parameter twice is not two that are equal"


def test_joining_takes_the_beginning_of_one_and_the_end_of_another() -> None:
    rng = derive(1, "join")
    first = tuple(stimulus(f"A{n}", at_s=float(5 * n)) for n in range(1, 5))
    second = tuple(stimulus(f"B{n}", at_s=float(5 * n)) for n in range(1, 5))
    mixed = 0
    for _ in range(50):
        names = [one.name for one in sequences.join(rng, first, second, RHYTHM)]
        kinds = "".join(name[0] for name in names)
        assert kinds == "A" * kinds.count("A") + "B" * kinds.count("B")
        mixed += "A" in kinds and "B" in kinds
    assert mixed > 10


# ---- the strategy -------------------------------------------------------------------------------------------------


def names_of(strategy: Strategy, count: int = 400) -> Counter[str]:
    cases = strategy.ask(count, derive(1, "names"))
    return Counter(one.name for case in cases for one in case.stimuli if one.values != (1500.0,))


def test_focus_draws_from_the_policys_own_inputs() -> None:
    only = Strategy(TEMPLATE, {**OWN, "focus": 1.0}, (), describe())
    assert set(names_of(only)) == {"MAV_CMD_DO_PARACHUTE", "ACRO", "FLIP", "CHUTE_ENABLED"}
    broad = names_of(Strategy(TEMPLATE, {**OWN, "focus": 0.0}, (), describe()))
    assert len(broad) > 150
    half = names_of(Strategy(TEMPLATE, {**OWN, "focus": 0.5}, (), describe()))
    assert half["MAV_CMD_DO_PARACHUTE"] > 5 * broad["MAV_CMD_DO_PARACHUTE"]


def test_the_policys_own_inputs_are_drawn_evenly_by_kind() -> None:
    names = names_of(Strategy(TEMPLATE, {**OWN, "focus": 1.0, "mutated": 0.0}, (), describe()), 600)
    total = names.total()
    assert names["MAV_CMD_DO_PARACHUTE"] / total == pytest.approx(1 / 3, abs=0.04)
    assert names["CHUTE_ENABLED"] / total == pytest.approx(1 / 3, abs=0.04)


def test_classes_are_drawn_evenly_as_published() -> None:
    strategy = Strategy(TEMPLATE, {"published": "A.CHUTE", "focus": 0.0, "release": 0.0}, (), describe())
    kinds = Counter(one.kind for case in strategy.ask(600, derive(1, "classes")) for one in case.stimuli)
    total = sum(kinds.values())
    assert kinds["parameter"] / total == pytest.approx(1 / 3, abs=0.04)
    assert kinds["sensor_fault"] / total == pytest.approx(1 / 3, abs=0.04)


def test_values_that_helped_are_used_again() -> None:
    strategy = Strategy(TEMPLATE, {**OWN, "focus": 1.0, "guided": 1.0, "mutated": 0.0}, (), describe())
    strategy.tell([outcome((stimulus("CHUTE_ENABLED", 0.125),), 3.0)])
    assert strategy.ask(1, derive(1, "x"))
    strategy.tell([outcome((stimulus("CHUTE_ENABLED", 0.375),), 2.0)])
    strategy.tell([outcome((stimulus("CHUTE_ENABLED", 0.625),), 9.0)])
    cases = strategy.ask(100, derive(1, "x"))
    used = {one.values for case in cases for one in case.stimuli if one.name == "CHUTE_ENABLED"}
    assert used == {(0.375,)}, "the value of the closest flight, and only that"


def test_values_of_usual_flights_are_not_credited() -> None:
    strategy = Strategy(TEMPLATE, {**OWN, "focus": 1.0, "guided": 1.0, "mutated": 0.0}, (), describe())
    strategy.tell([outcome((stimulus("CHUTE_ENABLED", 0.125 * n),), 1000.0) for n in range(1, 8)])
    cases = strategy.ask(100, derive(1, "x"))
    used = {one.values for case in cases for one in case.stimuli if one.name == "CHUTE_ENABLED"}
    assert len(used) > 2, "no value helped: they are drawn afresh"


def test_close_sequences_are_changed_and_violating_ones_are_done_with() -> None:
    strategy = Strategy(TEMPLATE, {**OWN, "mutated": 1.0}, (), describe())
    close = outcome((stimulus("CHUTE_ENABLED", 1.0), stimulus("ACRO", kind="mode", at_s=5.0)), 0.5)
    far = outcome((stimulus("FLIP", kind="mode"),), 900.0)
    strategy.tell([close, far])
    parents = Counter(case.origin.parent for case in strategy.ask(200, derive(1, "x")))
    assert parents[identity(close.test_case)] > parents[identity(far.test_case)] > 0
    broken = outcome((stimulus("CHUTE_ENABLED", 0.5), stimulus("ACRO", kind="mode", at_s=9.0)), -1.0)
    strategy.tell([broken])
    assert {case.origin.parent for case in strategy.ask(50, derive(1, "x"))} == {identity(far.test_case)}


def test_a_sequence_that_came_nearer_to_applying_is_preferred_and_one_that_applied_most() -> None:
    """Guidance as the searches of the benchmarks had it: 100 for all but applied, 1000 for nothing of it."""
    pairs = ((None, 0.0), (None, 0.5), (None, 1.0), (20.0, 0.0), (20.0, None), (None, None))
    told = [msgspec.structs.replace(outcome((), 1.0), robustness=one, nearness=near) for one, near in pairs]
    assert [one.guidance for one in told] == [1000.0, 550.0, 100.0, 20.0, 20.0, None]
    strategy = Strategy(TEMPLATE, {**OWN, "mutated": 1.0}, (), describe())
    near, far = (
        msgspec.structs.replace(outcome((stimulus(name, kind="mode"),), 1.0), robustness=None, nearness=nearness)
        for name, nearness in (("ACRO", 0.75), ("FLIP", 0.25))
    )
    strategy.tell([far, near])
    parents = Counter(case.origin.parent for case in strategy.ask(200, derive(1, "x")))
    assert parents[identity(near.test_case)] > parents[identity(far.test_case)] > 0


def test_times_end_before_the_flight_does() -> None:
    short = msgspec.structs.replace(TEMPLATE, scenario=Scenario(start=StartState(), time_limit_s=15.0))
    for case in Strategy(short, {"steps_max": 20}, (), describe()).ask(50, derive(1, "short")):
        assert all(one.at_s <= 7.0 for one in case.stimuli)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"steps_min": 9, "steps_max": 3}, "steps_min"),
        ({"published": "A.NONE"}, "published"),
        ({"modes": ["SIDEWAYS"]}, "SIDEWAYS"),
        ({"focus": 1.5}, "focus"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Setting], word: str) -> None:
    with pytest.raises(Refused, match=word):
        Strategy(TEMPLATE, settings, (), describe())


def test_closeness_orders_as_robustness_does() -> None:
    ordered = [-1000.0, -3.0, -0.5, 0.0, 0.2, 5.0, 1000.0]
    assert sorted(map(closeness, ordered)) == [closeness(value) for value in ordered]
    assert all(-1 < closeness(value) < 1 for value in ordered)
