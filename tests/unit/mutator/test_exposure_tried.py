"""What a procedure leaves open is gone through: no way is flown twice before every other was flown once."""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec
from exposure_cases import HAVE, HINTS, POLICIES, TEMPLATE

from saflite.contract.rng import derive
from saflite.contract.test_case import Origin, Stimulus, TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.attention import Span, note, read_spans
from saflite.mutator.exposure.drawing import Drawing, Shares
from saflite.mutator.exposure.procedures import moves, read_procedures
from saflite.mutator.exposure.scenarios import TURNS, YAW, items_of, scenarios_of
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.tried import Tried, Variant
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.strategies.exposure import Strategy

DRAWING = Drawing(Vocabulary(HAVE, Taken()), {}, Shares(own=0.75, swarm=0.8, faults=0.15, beyond=0.15))
(ONE, TWO) = read_procedures(
    ["upright air 20; LOITER|ALT_HOLD|GUIDED; ?RC1 1000|2000; wait 1..2", "upright air 20; CIRCLE; wait 1..2"],
    POLICIES,
    HAVE,
)["upright"]


def flown(*spans: Span, until_s: float = 100.0) -> tuple[TestCase, set[int]]:
    stimuli = tuple(Stimulus(at_s=span.from_s + 1.0, kind="mode", name="LOITER") for span in spans)
    case = msgspec.structs.replace(TEMPLATE, stimuli=stimuli, origin=Origin(note=note((), "fresh", spans)))
    return case, {place for place, one in enumerate(stimuli) if one.at_s <= until_s}


def test_every_option_comes_once_before_any_comes_again() -> None:
    rng = derive(1, "tried")
    for again in range(20):
        tried = Tried()
        names: Counter[str] = Counter()
        for _ in range(6):
            steps = moves(derive(again, "moves"), ONE, DRAWING, Variant(tried, rng, ONE))
            names.update(one.stimulus.name for one in steps if one.stimulus is not None)
        assert [names[name] for name in ("LOITER", "ALT_HOLD", "GUIDED", "RC1")] == [2, 2, 2, 3]


def test_what_was_flown_is_remembered_and_what_was_only_proposed_is_not() -> None:
    rng = derive(2, "tried")
    tried = Tried()
    first = Variant(tried, rng, ONE)
    moves(rng, ONE, DRAWING, first)
    tried.begin()
    tried.tell(*flown(Span("upright", 5.0, first.text)))
    assert tried.least(rng, "upright", [0, 1]) == TWO.number, "the first procedure was flown"
    modes = {moves(rng, ONE, DRAWING, Variant(tried, rng, ONE))[0].stimulus for _ in range(2)}
    taken = int(first.text.split("-")[1].partition(".")[2])
    left = {name for place, name in enumerate(("LOITER", "ALT_HOLD", "GUIDED")) if place != taken}
    assert {one.name for one in modes if one is not None} == left


def test_a_phase_that_the_flight_did_not_reach_does_not_count() -> None:
    tried = Tried()
    tried.tell(*flown(Span("upright", 5.0, "0"), Span("upright", 50.0, "1"), until_s=20.0))
    assert tried.least(derive(1, "tried"), "upright", [0, 1]) == 1
    tried.begin()
    tried.tell(*flown(Span("upright", 5.0, "1"), Span("upright", 50.0, "1")))
    assert tried.least(derive(1, "tried"), "upright", [0, 1]) == 0


def test_a_note_of_another_hand_is_taken_as_it_is() -> None:
    tried = Tried()
    tried.tell(*flown(Span("upright", 5.0, "7-99.99-1.1"), Span("nobody", 9.0, "0")))
    assert tried.least(derive(3, "tried"), "upright", [0]) == 0


def test_a_search_goes_through_the_procedures_of_a_rule() -> None:
    texts = [f"upright air 20; {mode}; wait 8..9" for mode in ("LOITER", "ALT_HOLD", "GUIDED", "CIRCLE", "BRAKE")]
    told: dict[str, Any] = {"hints": HINTS, "procedures": texts, "phases_max": 20, "followed": 1.0}
    rest = {"crossed": 0.0, "kept": 0.0, "routed": 0.0}
    long = msgspec.structs.replace(TEMPLATE.scenario, time_limit_s=900.0)
    search = Strategy(msgspec.structs.replace(TEMPLATE, scenario=long), told | rest, POLICIES, describe())
    ways: Counter[str] = Counter()
    for case in search.ask(40, derive(4, "ask")):
        ways.update(span.variant for span in read_spans(case.origin.note) if span.policy == "upright")
    assert set(ways) - {""} == {"0", "1", "2", "3", "4"}
    often = [ways[str(number)] for number in range(5)]
    assert min(often) >= 4
    assert max(often) - min(often) <= 1


def test_items_of_missions_come_each_way_before_one_comes_again() -> None:
    tried = Tried()
    scenarios = scenarios_of(TEMPLATE.scenario, describe(), tried)
    turns: Counter[tuple[float | None, ...]] = Counter()
    for number in range(60):
        mission = scenarios.mission(derive(number, "missions")).mission
        assert mission is not None
        tried.begin()
        tried.tell(TEMPLATE, (), items_of(mission))
        turns.update(item.params[2:4] for item in mission.items if item.command == YAW)
    assert set(turns) == set(TURNS)
    assert max(turns.values()) - min(turns.values()) <= 4, "several in one mission are drawn before it is flown"
