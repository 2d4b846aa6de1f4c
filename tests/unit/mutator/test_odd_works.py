"""Whatever decodable work a mutator is given, it proposes or refuses: nothing a message can hold breaks it."""

from __future__ import annotations

import msgspec
import pytest

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import (
    STIMULI_MAX,
    Mission,
    Obstacle,
    Origin,
    Scenario,
    StartState,
    Stimulus,
    Target,
    TestCase,
)
from saflite.contract.verdict import Transition
from saflite.contract.work import Outcome, RuleOutcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.geometry import COMPETITION_AREA, COMPETITION_SIZES, overlap
from saflite.flight.mission import builtin_mission
from saflite.mutator.exposure.phases import Script, Tempo
from saflite.mutator.operators import boxes, inputs, tracks, values
from saflite.mutator.registry import load_strategy, strategy_names
from saflite.mutator.strategies import camba, exposure, messages

MISSION2 = builtin_mission("mission2")
FLOWN = TestCase(target=Target(), scenario=Scenario(mission=MISSION2))
HELD = TestCase(target=Target(), scenario=Scenario(start=StartState(), time_limit_s=60.0))
HUGE, TINY = 3.4e38, 1e-323


def box(**changes: float) -> Obstacle:
    return Obstacle(**({"length_m": 5.0, "width_m": 4.0, "height_m": 20.0, "x_m": 0.0, "y_m": 20.0} | changes))


def told(case: TestCase, **changes: object) -> Outcome:
    fields = {"ending": "completed", "robustness": 1.0, "round": 0, **changes}
    return msgspec.convert({"test_case": case, **fields}, Outcome, from_attributes=True)


LAYOUTS = (
    (),
    (box(length_m=0.0, width_m=0.0), box(length_m=0.0, width_m=0.0)),
    (box(length_m=0.0), box(width_m=0.0)),
    (box(x_m=HUGE), box(x_m=-HUGE, rotation_deg=HUGE)),
    tuple(box(x_m=float(x_m)) for x_m in range(12)),
)
STIMULI = (
    (),
    (Stimulus(at_s=HUGE, kind="command", name="MAV_CMD_NAV_LAND", values=tuple(map(float, range(40)))),) * 2,
    (Stimulus(at_s=-HUGE, kind="parameter", name="RTL_ALT", values=(HUGE, -HUGE)),),
    (Stimulus(at_s=0.0, kind="mode", name="", values=(1.0,)), Stimulus(at_s=0.0, kind="stick", name="RC3")),
)
RULES = ((), (RuleOutcome("p", "vacuous", TINY), RuleOutcome("p", "vacuous", 0.0), RuleOutcome("q", "held", 1.0, 0.0)))
TRACKS = ((), ((0.0, 1e300, -1e300, 0.0),) * 2)


def histories() -> list[Outcome]:
    origins = (Origin(), Origin(parent="0" * 16, note="up 1e300 1e300 between"), Origin(note="down nan inf x for p"))
    cases = [
        msgspec.structs.replace(base, stimuli=stimuli, origin=origin, scenario=scenario)
        for base in (FLOWN, HELD)
        for stimuli, origin in zip(STIMULI, (*origins, Origin()), strict=True)
        for layout in LAYOUTS
        for scenario in [msgspec.structs.replace(base.scenario, obstacles=layout)]
    ]
    return [
        told(
            case,
            round=number,
            rules=RULES[number % 2],
            track=TRACKS[number % 2],
            robustness=(None, -HUGE, 0.0)[number % 3],
        )
        for number, case in enumerate(cases)
    ]


@pytest.mark.parametrize("name", strategy_names())
@pytest.mark.parametrize("policies", [(), ("p", "p", "q")])
def test_every_strategy_proposes_or_refuses_whatever_it_is_told(name: str, policies: tuple[str, ...]) -> None:
    proposed = 0
    for template in (FLOWN, HELD, msgspec.structs.replace(HELD, scenario=Scenario())):
        try:
            strategy = load_strategy(name)(template, {}, policies, describe())
        except Refused:
            continue
        strategy.tell(histories())
        for count in (0, 4):
            proposed += len(strategy.ask(count, derive(1, "odd")))
    assert proposed in (0, 4, 8)


def odd_target(**changes: object) -> TargetInfo:
    entry = msgspec.convert({"kind": "parameter", "name": "P", **changes}, InputInfo)
    return msgspec.structs.replace(describe(), inputs=(entry,))


@pytest.mark.parametrize(
    "wrong",
    [{"low": 5.0, "high": -5.0}, {"low": -1e300, "high": 1e300, "type": "whole"}, {"low": 1e19, "type": "whole"}],
)
def test_a_range_that_is_none_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(Refused, match="input P"):
        inputs.target_inputs(odd_target(**wrong), {})


@pytest.mark.parametrize("kind", ["parameter", "stick"])
def test_a_range_of_whole_numbers_that_holds_none_gives_one_beside_it(kind: str) -> None:
    (entry,) = inputs.target_inputs(odd_target(kind=kind, low=0.2, high=0.8, type="whole"), {}).values()
    drawn = {values.draw(derive(number, "odd"), entry, 0.0)[0] for number in range(50)}
    assert drawn <= {0.0, 0.2, 0.8, 1.0}


def test_a_command_of_more_numbers_than_commands_have_is_changed_within_those() -> None:
    entry = inputs.Input("command", "MAV_CMD_NAV_LAND")
    given = tuple(map(float, range(500, 540)))
    moved = values.jitter(derive(1, "odd"), entry, given)
    assert moved[7:] == given[7:]
    assert moved != given


def test_boxes_without_width_part_like_lines() -> None:
    across, along = box(length_m=0.0, width_m=10.0), box(width_m=0.0, length_m=10.0)
    assert overlap(across, along)
    assert not overlap(across, msgspec.structs.replace(along, x_m=6.0))
    assert not boxes.allowed(box(x_m=30.0), [across], boxes.Rules(COMPETITION_AREA, COMPETITION_SIZES))


def test_a_way_round_the_world_is_told_in_few_points() -> None:
    items = tuple(
        msgspec.structs.replace(item, params=(*item.params[:4], latitude, 10.0, HUGE))
        for item, latitude in zip(MISSION2.items, (80.0, -80.0) * len(MISSION2.items), strict=False)
    )
    way = tracks.planned(Mission(name="m", home_lat_deg=0.0, home_lon_deg=0.0, home_alt_m=0.0, items=items))
    assert len(way) <= tracks.POINTS_MAX + len(items) + 1


def test_an_anchor_at_no_place_is_none() -> None:
    assert camba.anchor_in("up nan 1.0 x") is None
    assert camba.anchor_in("up 1.0 1e999 x") is None


def test_messages_that_are_never_sent_are_numbers_and_leave_some() -> None:
    target = odd_target(kind="command", name="MSP")
    every: list[object] = [float(row.number) for row in messages.message_table()]
    for wrong in (["x"], [True], every):
        with pytest.raises(Refused, match="never"):
            messages.Strategy(HELD, {"never": wrong}, (), target)  # type: ignore[dict-item]


def test_messages_found_a_thousand_times_are_drawn_yet() -> None:
    strategy = messages.Strategy(HELD, {}, (), odd_target(kind="command", name="MSP"))
    numbers = [float(row.number) for row in messages.message_table()]
    stimuli = tuple(Stimulus(at_s=0.0, kind="command", name="MSP", values=(number,)) for number in numbers)
    found = told(msgspec.structs.replace(HELD, stimuli=stimuli), violated=("p",))
    strategy.tell([found] * 1000)
    assert len(strategy.ask(3, derive(1, "odd"))) == 3


@pytest.mark.parametrize("text", ["p start:GUIDED@1e999", "p start:GUIDED@nan", "p start:GUIDED@-1e300"])
def test_a_start_at_no_height_is_refused(text: str) -> None:
    with pytest.raises(Refused, match="hints"):
        exposure.Strategy(HELD, {"hints": [text]}, ("p",), describe())


@pytest.mark.parametrize(
    "text",
    [
        "[" * 60_000,
        '{"scenario":{},"stimuli":[],"new":' + "9" * 400 + "}",
        '{"scenario":{},"stimuli":[],"progress":{"p":1e300}}',
    ],
)
def test_a_corpus_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(Refused, match="corpus"):
        exposure.Strategy(HELD, {"corpus": [text]}, ("p",), describe())


@pytest.mark.parametrize("place", [1, 2**53, -1, -(2**63)])
@pytest.mark.parametrize("preceding", [0, 1, -1])
def test_a_step_after_an_input_that_was_never_given_is_learnt_from_all_the_same(place: int, preceding: int) -> None:
    given = Stimulus(at_s=0.0, kind="parameter", name="RTL_ALT", values=(1.0,))
    case = msgspec.structs.replace(HELD, stimuli=(given,))
    step = Transition("STABILIZE", "LAND failsafe", place, preceding)
    strategy = exposure.Strategy(HELD, {}, ("p",), describe())
    strategy.tell([told(case, transitions=(step,))])
    assert len(strategy.ask(2, derive(1, "odd"))) == 2


def test_a_flight_without_end_gets_no_more_inputs_than_a_test_case_holds() -> None:
    script = Script(Tempo(0.0, 1e12, (1.0, 2.0), {}))
    for _ in range(STIMULI_MAX + 1):
        script.give(Stimulus(at_s=0.0, kind="mode", name="LAND"))
    assert script.is_full
    assert len(script.stimuli()) == STIMULI_MAX
