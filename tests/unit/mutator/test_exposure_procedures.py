"""Procedures: what their texts mean, what is refused, and how phases of `exposure` follow them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from itertools import pairwise

import msgspec
import pytest
from exposure_cases import HAVE, POLICIES, TEMPLATE, strategy

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Stimulus, StimulusKind
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.attention import read_spans
from saflite.mutator.exposure.drawing import Drawing, Shares
from saflite.mutator.exposure.hints import Hint
from saflite.mutator.exposure.procedures import Move, Procedure, Span, broken_off, moves, read_procedures, without_entry
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import ENDS, Vocabulary
from saflite.mutator.operators.commands import DEG_PER_M, HOME_LAT_DEG, HOME_LON_DEG

REST: Mapping[tuple[StimulusKind, str], float] = {
    (entry.kind, entry.name): entry.default for entry in describe().inputs if entry.default is not None
}
DRAWING = Drawing(Vocabulary(HAVE, Taken()), REST, Shares(own=0.75, swarm=0.8, faults=0.15, beyond=0.15))


def read(steps: str) -> Procedure:
    return read_procedures([f"upright {steps}"], POLICIES, HAVE)["upright"][0]


def drawn(steps: str, seed: int = 1) -> list[Move]:
    return moves(derive(seed, "moves"), read(steps), DRAWING)


def test_a_procedure_begins_in_the_air_or_on_the_ground() -> None:
    air, ground, takeoff, last = (
        read(f"{begin}; LOITER") for begin in ("air 5..20", "ground", "takeoff", "air 9 last")
    )
    assert air.height_m == (5.0, 20.0)
    assert last.height_m == (9.0, 9.0)
    assert [one.begins for one in (air, ground, takeoff)] == ["air", "ground", "ground"]
    assert [one.lifts for one in (air, ground, takeoff)] == [False, False, True]
    assert [one.last for one in (air, ground, takeoff, last)] == [False, False, False, True]


def test_values_are_drawn_from_their_choices_and_ranges() -> None:
    for seed in range(40):
        mode, stick, setting, fault = drawn(
            "air 20; LOITER|ALT_HOLD; wait 2..3; RC1|RC2 1000..1100|1900; RTL_ALT 300..3000; SIM_GPS_DISABLE 1", seed
        )
        assert mode.stimulus is not None
        assert mode.stimulus.name in ("LOITER", "ALT_HOLD")
        assert 2.0 <= mode.after_s <= 3.0
        assert stick.stimulus is not None
        assert stick.stimulus.name in ("RC1", "RC2")
        (pwm,) = stick.stimulus.values
        assert pwm == 1900.0 or 1000.0 <= pwm <= 1100.0
        assert setting.stimulus is not None
        assert 300.0 <= setting.stimulus.values[0] <= 3000.0
        assert setting.after_s < 0.5
        assert fault.stimulus is not None
        assert fault.stimulus.values == (1.0,)


def test_a_place_lies_as_far_from_home_and_as_high_as_it_says() -> None:
    (move,) = drawn("air 20; MAV_CMD_DO_REPOSITION at 100 30..40")
    assert move.stimulus is not None
    *_, lat, lon, high = move.stimulus.values
    north = (lat - HOME_LAT_DEG) / DEG_PER_M
    east = (lon - HOME_LON_DEG) / DEG_PER_M * math.cos(math.radians(HOME_LAT_DEG))
    assert math.hypot(north, east) == pytest.approx(100.0, abs=0.1)
    assert 30.0 <= high <= 40.0


def test_numbers_of_a_command_that_are_not_told_are_zero() -> None:
    (move,) = drawn("ground; MAV_CMD_COMPONENT_ARM_DISARM 1")
    assert move.stimulus is not None
    assert move.stimulus.values == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_what_rests_has_its_default_and_what_may_be_left_out_is_half_the_time() -> None:
    (move,) = drawn("air 20; SIM_GPS_NUMSATS rest")
    assert move.stimulus is not None
    assert move.stimulus.values == (REST["sensor_fault", "SIM_GPS_NUMSATS"],)
    given = sum(len(drawn("air 20; ?RTL_ALT ~; LOITER", seed)) == 2 for seed in range(200))
    assert 70 < given < 130


@pytest.mark.parametrize(
    "text",
    [
        "",
        "upright",
        "upright air; LOITER",
        "upright air 5..20",
        "upright air 20..5; LOITER",
        "upright air nan; LOITER",
        "upright air 1e3; LOITER",
        "upright ground 5; LOITER",
        "upright hover 5; LOITER",
        "upright ground; LOITER 3",
        "upright ground; LOITER|RC1 1500",
        "upright ground; NO_SUCH 1",
        "upright ground; RC1 1500 1600",
        "upright ground; RC1 at 3 4",
        "upright ground; MAV_CMD_DO_REPOSITION at 3",
        "upright ground; MAV_CMD_DO_REPOSITION rest",
        "upright ground; wait",
        "upright ground; wait 1..2..3",
        "upright ground; wait 10000",
        "upright ground; RC1 1500..",
        "upright ground; RC1 " + "9" * 400,
        "upright ground" + "; LOITER" * 41,
    ],
)
def test_a_text_of_another_shape_is_refused_with_the_text(text: str) -> None:
    with pytest.raises(Refused, match="procedures"):
        strategy(procedures=[text])


def test_those_of_policies_that_are_not_searched_are_left_out() -> None:
    assert read_procedures(["other ground; LOITER"], POLICIES, HAVE) == {}


def test_a_phase_follows_a_procedure_and_takes_back_what_it_gave() -> None:
    text = "a-rtl1 air 20; RTL_ALT 777; GUIDED; wait 5; RC1 1913; wait 2; RTL; wait 9"
    searching = strategy(procedures=[text], followed=1.0, kept=0.0, routed=0.0)
    seen = 0
    for case in searching.ask(60, derive(1, "ask")):
        spans = read_spans(case.origin.note)
        if not spans or spans[0].policy != "a-rtl1":
            continue
        height = [one.at_s for one in case.stimuli if one.name == "RTL_ALT" and one.values == (777.0,)]
        stick = [one.at_s for one in case.stimuli if one.name == "RC1" and one.values == (1913.0,)]
        home = [one.at_s for one in case.stimuli if one.name == "RTL" and stick and one.at_s > stick[0]]
        back = [one.at_s for one in case.stimuli if one.name == "RC1" and one.values == (1500.0,)]
        if not (height and stick and home and back):  # cut off by the end of the flight
            continue
        seen += 1
        assert height[0] < stick[0] < home[0] < back[0]
        assert home[0] - stick[0] >= 1.98  # times are rounded
        assert back[0] - home[0] >= 8.9
    assert seen > 5


def test_one_may_begin_while_another_is_under_way_and_all_is_taken_back() -> None:
    texts = ["a-rtl1 air 20; GUIDED; wait 5; RTL; wait 9", "upright air 20; SIM_GPS_DISABLE 1; wait 40; LAND; wait 3"]
    settings = {"procedures": texts, "followed": 1.0, "kept": 0.0, "routed": 0.0, "faults": 0.0, "own": 1.0}
    crossed = dict.fromkeys((0.0, 1.0), 0)
    for share in crossed:
        for case in strategy(**settings, crossed=share).ask(60, derive(1, "ask")):
            spans = [span for span in read_spans(case.origin.note) if span.policy in ("a-rtl1", "upright")]
            if not spans or spans[0].policy != "a-rtl1":
                continue
            until_s = spans[1].from_s if len(spans) > 1 else math.inf
            own = [one for one in case.stimuli if spans[0].from_s <= one.at_s < until_s]
            lost = [one for one in own if one.name == "SIM_GPS_DISABLE"]
            home = [one for one in own if one.name == "RTL"]
            if not home or not lost or lost[0].at_s > home[0].at_s:
                continue
            crossed[share] += 1
            assert home[0].at_s - lost[0].at_s < 60.0
            if len(spans) > 1:
                assert lost[-1].values == (0.0,)
    assert crossed[0.0] == 0
    assert crossed[1.0] > 3


def test_what_is_broken_off_stops_within_a_step() -> None:
    steps = drawn("air 20; LOITER; wait 20; RTL_ALT 777; wait 10; RTL; wait 30")
    ends = set()
    for seed in range(60):
        kept = broken_off(derive(seed, "broken off"), steps)
        ends.add(len(kept))
        assert [one.stimulus for one in kept] == [one.stimulus for one in steps[: len(kept)]]
        assert [one.after_s for one in kept[:-1]] == [one.after_s for one in steps[: len(kept) - 1]]
        assert 0.0 <= kept[-1].after_s <= steps[len(kept) - 1].after_s
    assert ends == {1, 2, 3}
    assert broken_off(derive(1, "broken off"), []) == []


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ("air 20; RTL_ALT 777; LOITER; wait 2; SIM_GPS_DISABLE 1; RTL", ["RTL_ALT", "SIM_GPS_DISABLE", "RTL"]),
        ("air 20; GUIDED; wait 5; RTL; wait 9", ["GUIDED", "RTL"]),
        ("air 20; LOITER; wait 5; RTL_ALT 777", ["LOITER", "RTL_ALT"]),
        ("air 20; SIM_GPS_DISABLE 1; LOITER; wait 5", ["SIM_GPS_DISABLE", "LOITER"]),
    ],
)
def test_what_a_procedure_gives_may_come_in_the_state_at_hand(text: str, left: list[str]) -> None:
    steps = without_entry(drawn(text))
    assert [one.stimulus.name for one in steps if one.stimulus is not None] == left


def test_one_begun_in_the_middle_of_another_enters_its_own_mode_or_does_not() -> None:
    texts = ["upright air 20; LOITER; wait 5; SIM_GPS_DISABLE 1; wait 9", "a-rtl1 air 20; RTL; wait 40"]
    settings = {"procedures": texts, "followed": 1.0, "crossed": 1.0, "kept": 0.0, "routed": 0.0, "own": 1.0}
    before: set[str] = set()
    for case in strategy(**settings).ask(40, derive(1, "ask")):
        lost = [one for one in case.stimuli if one.name == "SIM_GPS_DISABLE" and one.values[0]]
        orders = [one for one in case.stimuli if one.kind == "mode" or one in lost]
        before |= {one.name for one, after in pairwise(orders) if after in lost}
    assert {"LOITER", "RTL"} <= before


def test_one_that_needs_height_is_brought_there_from_wherever_the_vehicle_flies() -> None:
    texts = ["upright air 40..50; LOITER; wait 3", "a-chute air 8; LOITER; wait 3", "a-rtl1 air 8; LOITER; wait 3"]
    searching = strategy(procedures=texts, followed=1.0, kept=0.0, routed=0.0, phases_max=3)
    brought = 0
    for case in searching.ask(30, derive(3, "ask")):
        spans = read_spans(case.origin.note)
        for place, span in enumerate(spans):
            until_s = spans[place + 1].from_s if place + 1 < len(spans) else 60.0
            own = [one for one in case.stimuli if span.from_s <= one.at_s < until_s and one.kind == "command"]
            heights = [one.values[6] for one in own if one.name in ("MAV_CMD_DO_REPOSITION", "MAV_CMD_NAV_TAKEOFF")]
            if place and heights and span.policy == "upright":
                assert 40.0 <= heights[0] <= 50.0
                brought += 1
    assert brought > 5


def test_what_ends_a_flight_is_seldom_given_to_a_rule_that_is_not_about_it() -> None:
    rng, style = derive(1, "draw"), DRAWING.style(derive(1, "style"), Hint("upright"))._replace(kinds=("command",))
    drawn = Counter(DRAWING.draw(style, rng).name for _ in range(4000))
    usual = sorted(drawn[name] for name in drawn if name not in ENDS)
    assert max(drawn[name] for name in ENDS) < 0.5 * usual[len(usual) // 2]
    assert sum(drawn[name] for name in ENDS) > 0


def test_without_procedures_nothing_is_followed() -> None:
    one, other = strategy(followed=1.0), strategy(followed=0.0)
    assert one.ask(12, derive(1, "ask")) == other.ask(12, derive(1, "ask"))


def test_what_ends_a_flight_comes_last() -> None:
    texts = ["a-chute air 20 last; MAV_CMD_DO_PARACHUTE 2; wait 3", "upright air 20; LOITER; wait 3"]
    searching = strategy(procedures=texts, followed=1.0, kept=0.0, routed=0.0, phases_max=3)
    places = [
        [span.policy for span in read_spans(case.origin.note)].index("a-chute")
        for case in searching.ask(30, derive(2, "ask"))
        if {"a-chute", "upright"} <= {span.policy for span in read_spans(case.origin.note)}
    ]
    assert places
    assert min(places) >= 1
    assert TEMPLATE.scenario.time_limit_s == 60.0


def test_what_was_seldom_given_in_a_mode_is_given_there_and_nothing_that_ends_a_flight() -> None:
    taken = Taken()
    vocabulary = Vocabulary(HAVE, taken)
    first = vocabulary.draw_seldom(derive(1, "seldom"), "")
    assert first is not None
    stimuli = tuple(Stimulus(at_s=0.0, kind=first.kind, name=first.name) for _ in range(1000))
    before = [vocabulary.draw_seldom(derive(seed, "seldom"), "") for seed in range(200)]
    taken.tell(msgspec.structs.replace(TEMPLATE, stimuli=stimuli), (), range(1000), ())
    after = [vocabulary.draw_seldom(derive(seed, "seldom"), "") for seed in range(200)]
    elsewhere = [vocabulary.draw_seldom(derive(seed, "seldom"), "RTL") for seed in range(200)]
    assert before.count(first) > 3 * after.count(first)
    assert elsewhere == before
    assert not {one.name for one in before if one is not None}.intersection(ENDS)
    assert "parameter" not in {one.kind for one in before if one is not None}


def test_a_range_is_drawn_from_at_its_ends_too() -> None:
    rng = derive(1, "test")
    drawn = [Span(0.0, 300.0).draw(rng) for _ in range(400)]
    assert all(0.0 <= value <= 300.0 for value in drawn)
    assert 10 < drawn.count(0.0) < 60
    assert 10 < drawn.count(300.0) < 60


def test_a_procedure_of_another_rule_is_flown_for_a_policy_where_it_is_lent() -> None:
    own, other = "upright air 20; BRAKE; wait 5", "brake-holds air 20; RTL_ALT 777; LOITER; wait 5"
    settings = {"procedures": [own], "followed": 1.0, "crossed": 0.0, "kept": 0.0, "routed": 0.0, "own": 1.0}

    def lent(share: float, others: list[str]) -> int:
        cases = strategy(**settings, others=others, lent=share).ask(40, derive(1, "ask"))
        return sum(any(one.values == (777.0,) for one in case.stimuli) for case in cases)

    assert lent(0.0, [other]) == 0
    assert 0 < lent(0.25, [other]) < lent(1.0, [other])
    assert lent(1.0, []) == 0


def test_without_other_rules_their_share_draws_nothing() -> None:
    settings = {"procedures": ["upright air 20; LOITER; wait 5"]}
    drawn_with = [strategy(**settings, lent=share).ask(20, derive(1, "ask")) for share in (0.0, 0.9)]
    assert drawn_with[0] == drawn_with[1]
