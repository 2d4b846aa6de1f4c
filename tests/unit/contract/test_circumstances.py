"""What maintainers ask first: worked out from what is known, for whatever target."""

from __future__ import annotations

import pytest

from saflite.contract.circumstances import Circumstances, circumstances_of, in_words
from saflite.contract.flight import Delivered
from saflite.contract.target_info import InputInfo, SettingInfo, TargetInfo
from saflite.contract.test_case import Obstacle, Origin, Scenario, StartState, Stimulus, Target, TestCase

INPUTS = (
    InputInfo(kind="parameter", name="GAIN", low=0.0, high=2.0, unit="1/s"),
    InputInfo(kind="parameter", name="BOOT", low=0.0, high=9.0, at_start=True),
    InputInfo(kind="parameter", name="CODE", choices=(0.0, 3.0)),
    InputInfo(kind="parameter", name="FREE"),
    InputInfo(kind="stick", name="RC1", low=1000.0, high=2000.0),
    InputInfo(kind="mode", name="HOLD"),
    InputInfo(kind="command", name="SWITCH", type="flag", low=0.0, high=1.0, link="pilot"),
    InputInfo(kind="command", name="MESSAGE", low=1.0, high=1.0),
    InputInfo(kind="sensor_fault", name="wind", low=0.0, high=15.0),
)
INFO = TargetInfo(
    name="some",
    build="b",
    repeats="bitwise",
    inputs=INPUTS,
    signals=(),
    settings={"bugs": SettingInfo(meaning="planted", default="", choices=("", "one"), breaks={"one": "rule"})},
)


def found(*stimuli: Stimulus, delivered: tuple[Delivered, ...] | None = None, note: str = "") -> Circumstances:
    scenario = Scenario(start=StartState())
    case = TestCase(target=Target(name="some"), scenario=scenario, stimuli=stimuli, origin=Origin(note=note))
    return circumstances_of(case, INFO, delivered)


def given(kind: str, name: str, *values: float, at_s: float = 3.0) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("stimulus", "values", "link"),
    [
        (given("parameter", "GAIN", 2.0), "inside", "trusted"),
        (given("parameter", "GAIN", 2.1), "outside", "trusted"),
        (given("parameter", "GAIN", 1.0, at_s=0.0), "inside", "setup"),
        (given("parameter", "BOOT", 10.0), "outside", "setup"),
        (given("parameter", "CODE", 3.0), "inside", "trusted"),
        (given("parameter", "CODE", 2.0), "outside", "trusted"),
        (given("parameter", "FREE", 2.0), "undocumented", "trusted"),
        (given("stick", "RC1", 900.0), "outside", "pilot"),
        (given("mode", "HOLD"), "inside", "pilot"),
        (given("command", "SWITCH", 1.0), "inside", "pilot"),
        (given("command", "MESSAGE", 1.0, 255.0), "undocumented", "trusted"),
        (given("sensor_fault", "wind", 15.0), "inside", "none"),
    ],
)
def test_ranges_and_links_are_those_the_target_names(stimulus: Stimulus, values: str, link: str) -> None:
    told = found(stimulus)
    assert (told.values, told.link) == (values, link)
    assert told.minimal
    assert told.stock


def test_the_widest_link_counts_and_what_was_denied_does_not() -> None:
    stimuli = given("sensor_fault", "wind", 3.0), given("mode", "HOLD"), given("parameter", "GAIN", 9.0)
    assert found(*stimuli).link == "trusted"
    assert not found(*stimuli).minimal
    assert found(*stimuli, note="shrunk: to 3").minimal
    answers = (
        Delivered(index=0, at_s=3.0),
        Delivered(index=1, at_s=3.0),
        Delivered(index=2, at_s=3.0, answer="denied"),
    )
    told = found(*stimuli, delivered=answers)
    assert (told.link, told.values) == ("pilot", "inside")
    assert told.steps == ("at 3 s: sensor_fault wind 3", "at 3 s: mode HOLD")


def test_what_was_planted_is_no_stock_build() -> None:
    target = Target(name="some", settings={"bugs": "one"}, parameters={"GAIN": 5.0})
    told = circumstances_of(TestCase(target=target, scenario=Scenario(start=StartState())), INFO)
    assert not told.stock
    assert told.options == "planted: one"
    assert told.outside == ("GAIN 5, documented 0 to 2 1/s",)
    assert told.link == "setup"
    assert told.steps == ("bugs = one", "parameter GAIN 5")
    assert "outside documented ranges" in in_words(told)["values"]
    several = Target(name="some", settings={"bugs": ["one", "two"]})
    told = circumstances_of(TestCase(target=several, scenario=Scenario(start=StartState())), INFO)
    assert told.options == "planted: one, two"


def test_what_was_made_smaller_names_its_smallest_form() -> None:
    """Else a find that was minimised reads as one that was not."""
    told = found(given("mode", "HOLD"), given("parameter", "GAIN", 9.0))
    assert in_words(told)["steps"] == "2, not minimised"
    assert in_words(told, "0123456789abcdef")["steps"] == "2, 0123456789abcdef is its smallest form"
    small = found(given("mode", "HOLD"), given("parameter", "GAIN", 9.0), note="shrunk: to 2")
    assert in_words(small)["steps"] == "2, minimal"


def test_boxes_are_steps_too() -> None:
    box = Obstacle(length_m=6.0, width_m=4.0, height_m=20.0, x_m=1.0, y_m=15.0, rotation_deg=20.0)
    case = TestCase(target=Target(name="some"), scenario=Scenario(start=StartState(), obstacles=(box, box)))
    told = circumstances_of(case, INFO)
    assert told.steps == ("box of 6 x 4 x 20 m at (1, 15) m, turned 20 degrees",) * 2
    assert not told.minimal
    assert (told.values, told.link) == ("inside", "none")


def test_an_input_that_got_no_answer_counts_for_it_may_be_what_ended_the_autopilot() -> None:
    message = given("command", "MESSAGE", 1.0, 255.0)
    unheard = found(message, delivered=(Delivered(index=0, at_s=3.0, answer="timed_out"),))
    assert len(unheard.steps) == 1
    assert unheard.link == "trusted"
    assert unheard.undocumented == ("MESSAGE",)
    denied = found(message, delivered=(Delivered(index=0, at_s=3.0, answer="denied"),))
    assert denied.steps == ()


def test_an_input_that_was_denied_and_without_which_nothing_shows_counts() -> None:
    moved = given("command", "MESSAGE", 1.0, 255.0)
    denied = found(moved, delivered=(Delivered(index=0, at_s=3.0, answer="denied"),), note="shrunk: to 1")
    assert [step.endswith("(denied)") for step in denied.steps] == [True]
    assert denied.link == "trusted"
