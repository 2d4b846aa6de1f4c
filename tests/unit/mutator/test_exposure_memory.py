"""What `exposure` learns of flights besides their rules: where inputs are taken, in whose phases vehicles come down."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest
from exposure_cases import HAVE, TEMPLATE, case, given

from saflite.contract.rng import derive
from saflite.contract.test_case import Origin, Setting, Stimulus, StimulusKind, TestCase
from saflite.contract.verdict import Transition
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.commands import command_table
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.attention import Span, note, read_note, read_spans
from saflite.mutator.exposure.numbers import draw, moved
from saflite.mutator.exposure.survival import Survival
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.operators import commands
from saflite.mutator.strategies.exposure import Strategy

YAW: tuple[StimulusKind, str] = ("command", "MAV_CMD_CONDITION_YAW")


def noted(text: str, *stimuli: Stimulus) -> TestCase:
    return msgspec.structs.replace(case(*stimuli), origin=Origin(strategy="exposure", note=text))


def alone(*hints: str) -> Strategy:
    settings: dict[str, Setting] = {"starts": 0.0, "kept": 0.0, "routed": 0.0, "phases_max": 2}
    told: dict[str, Setting] = {**settings, "hints": list(hints)}
    return Strategy(TEMPLATE, told, tuple(hint.split()[0] for hint in hints), describe())


# ---- notes --------------------------------------------------------------------------------------------------------


def test_a_note_tells_when_whose_phase_began() -> None:
    spans = (Span("a-rtl1", 0.5, "2-1.0-13.2"), Span("upright", 12.25), Span("a-rtl1", 30.0, "0"))
    text = note(("upright",), "fresh", spans)
    assert read_note(text) == ("a-rtl1", "upright")
    assert read_spans(text) == spans
    assert read_spans(note(("upright",), "value")) == ()


@pytest.mark.parametrize("text", ["fresh for a@", "f for a@b", "f for @", "f for a@1e5", "x", "a@1 for b@-1"])
def test_a_note_of_another_shape_tells_no_phases(text: str) -> None:
    assert read_spans(text) == ()


# ---- where inputs are taken ---------------------------------------------------------------------------------------


def test_an_input_is_known_by_the_modes_that_take_it() -> None:
    taken = Taken()
    assert (taken.share(YAW, "LOITER"), taken.best(YAW)) == (0.5, "")
    turn = given("command", "MAV_CMD_CONDITION_YAW", 90.0)
    steps = (Transition("LOITER", "GUIDED", 1, -1), Transition("GUIDED", "GUIDED", 2, 1))
    for _ in range(4):
        taken.tell(case(turn, given("mode", "GUIDED", at_s=2.0), turn), steps, {0, 1, 2}, {1, 2})
    assert taken.best(YAW) == "GUIDED"
    assert taken.share(YAW, "GUIDED") > 0.8 > 0.2 > taken.share(YAW, "LOITER")
    vocabulary, rng = Vocabulary(HAVE, taken), derive(1, "test")
    drawn = {
        mode: [vocabulary.draw(rng, "p", ("command",), mode).name for _ in range(600)] for mode in ("GUIDED", "LOITER")
    }
    assert drawn["GUIDED"].count(YAW[1]) > 2 * drawn["LOITER"].count(YAW[1])


def test_a_mode_that_is_refused_here_is_entered_from_where_it_is_taken() -> None:
    searching = alone("flip-turns-once start:GUIDED@30 in:FLIP")
    flip, hold = given("mode", "FLIP"), given("mode", "ALT_HOLD", at_s=2.0)
    steps = (Transition("GUIDED", "ALT_HOLD", 1, -1), Transition("ALT_HOLD", "FLIP", 2, 1))
    flown = Outcome(test_case=case(flip, hold, flip), round=0, ending="completed", robustness=None, transitions=steps)

    def led() -> float:
        modes = [
            [one.name for one in made.stimuli if one.kind == "mode"] for made in searching.ask(60, derive(1, "ask"))
        ]
        before_flips = [before for names in modes for before, name in pairwise(["", *names]) if name == "FLIP"]
        return sum(before == "ALT_HOLD" for before in before_flips) / len(before_flips)

    before = led()
    searching.tell([flown] * 6)
    assert led() > max(0.6, 3 * before)


# ---- who brings it down -------------------------------------------------------------------------------------------


def test_phases_are_known_by_whether_the_vehicle_comes_down_or_never_flies_again() -> None:
    survival = Survival()
    stimuli = [given("stick", "RC1", 1000.0, at_s=float(at_s)) for at_s in (1, 11, 12, 21, 31)]
    up, land = Transition("LOITER", "LOITER", 0, -1), Transition("LAND", "LAND standing", -1, 0)
    lifted = Transition("LAND standing", "GUIDED", 1, 0)
    text = "fresh for whole@1.00 landing@10.00 chute@20.00 never@30.00"
    steps = (
        up,
        Transition("LOITER", "LAND", 1, 0),
        Transition("LAND", "LAND standing", 2, 1),
        msgspec.structs.replace(lifted, stimulus=3),
        Transition("GUIDED standing disarmed", "GUIDED standing disarmed", 4, 3),
    )
    for _ in range(8):
        survival.tell(noted(text, *stimuli), steps, crashed=False)
    assert survival.comes_down("whole") < 0.1 < 0.7 < survival.comes_down("landing")
    assert survival.ends("landing") < 0.1 < 0.7 < survival.ends("chute")
    assert survival.ends("never") == 0.0
    assert survival.comes_down("never") == pytest.approx(0.1), "it was on the ground all along"
    for _ in range(8):
        survival.tell(noted("fresh for fall@1.00 later@20.00", *stimuli), (up, land), crashed=True)
    assert survival.ends("fall") > 0.7
    assert survival.ends("later") == 0.0


def test_what_ends_flights_comes_last_and_a_lifted_phase_follows_what_brings_it_down() -> None:
    searching = alone(*(f"{name} start:LOITER@20 in:LOITER quiet:5" for name in ("chute", "fine")))
    stimuli = [given("stick", "RC1", 1000.0, at_s=float(at_s)) for at_s in (1, 11)]
    steps = (Transition("LOITER", "LOITER standing disarmed", 0, -1), Transition("X standing", "X standing", 1, 0))
    flown = Outcome(
        test_case=noted("fresh for chute@1.00 fine@10.00", *stimuli), round=0, ending="completed", robustness=None
    )
    searching.tell([msgspec.structs.replace(flown, transitions=steps)] * 10)
    both = [spans for made in searching.ask(80, derive(2, "ask")) if len(spans := read_spans(made.origin.note)) == 2]
    ordered = [spans[0].policy for spans in both if {span.policy for span in spans} == {"chute", "fine"}]
    assert len(ordered) > 10
    assert set(ordered) == {"fine"}


# ---- numbers that mean something ----------------------------------------------------------------------------------


def test_the_table_holds_commands_of_the_reference_vehicle_each_with_seven_numbers() -> None:
    mine = {f"MAV_CMD_{row.name}" for row in command_table().values()}
    assert set(commands.table()) <= mine
    assert all(len(row) == commands.COUNT for row in commands.table().values())


@pytest.mark.parametrize("name", sorted(commands.table()))
def test_numbers_of_a_known_command_lie_within_what_they_may_be(name: str) -> None:
    rng = derive(1, name)
    for _ in range(50):
        for number, meanings in zip(commands.draw(rng, name), commands.table()[name], strict=True):
            assert (number is None) == (not meanings)
            if number is None:
                continue
            spans = [one for one in meanings if isinstance(one, commands.Span)]
            words = [one for one in meanings if isinstance(one, str)]
            assert number in meanings or words or any(span.low <= number <= span.high for span in spans)


def test_unused_numbers_of_a_command_are_mostly_nothing_and_used_ones_mostly_meant() -> None:
    rng = derive(1, "yaw")
    turns = [draw(rng, HAVE[YAW], None, 0.15) for _ in range(400)]
    assert sum(turn[4:] == (0.0, 0.0, 0.0) for turn in turns) > 300
    assert (
        sum(0.0 <= turn[0] <= 360.0 and turn[2] in (-1.0, 0.0, 1.0) and turn[3] in (0.0, 1.0) for turn in turns) > 300
    )
    assert any(turn[0] < 0.0 or turn[0] > 360.0 for turn in turns)


def test_a_setting_moved_off_its_default_is_mostly_a_few_times_smaller_or_greater() -> None:
    entry, rng = HAVE["parameter", "RTL_LOIT_TIME"], np.random.default_rng(1)
    values = [moved(rng, entry, 5000.0) for _ in range(300)]
    assert sum(1250.0 <= value <= 20_000.0 and value != 5000.0 for value in values) > 200
