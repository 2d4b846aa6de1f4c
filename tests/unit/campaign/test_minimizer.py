"""Shrinking finds the smallest violating test case, whatever the order of answers."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from saflite.campaign.lifecycle.minimizer import Minimizer, names_of
from saflite.campaign.lifecycle.repeats import ONE_FLIGHT
from saflite.contract import wire
from saflite.contract.circumstances import ranges_kept
from saflite.contract.rng import derive
from saflite.contract.target_info import InputInfo
from saflite.contract.test_case import Mission, Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.flight.autopilots.reference.describe import describe

Breaks = Callable[[TestCase], bool]


def case(*stimuli: Stimulus, limit_s: float = 60.0) -> TestCase:
    return TestCase(
        target=Target(), scenario=Scenario(start=StartState(), time_limit_s=limit_s), stimuli=stimuli, rng_seed=3
    )


def twenty() -> TestCase:
    """A parachute in ACRO among eighteen inputs that do not matter."""
    rng = derive(1, "noise")
    noise = [
        Stimulus(at_s=1.0 + 2.5 * n, kind="parameter", name=f"P{n}", values=(float(rng.uniform(-9, 9)),))
        for n in range(20)
    ]
    noise[6] = Stimulus(at_s=16.0, kind="mode", name="ACRO")
    noise[13] = Stimulus(
        at_s=33.5, kind="command", name="MAV_CMD_DO_PARACHUTE", values=(2.0, 17.0, 3.0, 99.0, 4.0, 1.0, 8.0)
    )
    return case(*noise)


def chute_in_acro(test_case: TestCase) -> bool:
    names = [stimulus.name for stimulus in test_case.stimuli]
    chutes = [s for s in test_case.stimuli if s.name == "MAV_CMD_DO_PARACHUTE" and s.values[0] == 2.0]
    if "ACRO" not in names or not chutes:
        return False
    acro_s = next(s.at_s for s in test_case.stimuli if s.name == "ACRO")
    return chutes[0].at_s > acro_s + 0.4 and test_case.scenario.time_limit_s >= chutes[0].at_s + 2.0


def shrink(
    start: TestCase, breaks: Breaks, flights_max: int = 200, shuffle: int = 0, shown_s: float | None = None
) -> tuple[Minimizer, list[TestCase]]:
    minimizer, flown = Minimizer(start, flights_max, ONE_FLIGHT, shown_s), []
    rng = derive(shuffle, "order")
    while not minimizer.done:
        batch = list(minimizer.ask())
        for index in rng.permutation(len(batch)) if shuffle else range(len(batch)):
            case, number = batch[index]
            flown.append(case)
            minimizer.tell(identity(case), number, breaks(case))
    return minimizer, flown


def test_a_case_of_twenty_inputs_shrinks_to_the_two_that_matter() -> None:
    start = twenty()
    assert chute_in_acro(start)
    minimizer, flown = shrink(start, chute_in_acro)
    best = minimizer.best
    assert chute_in_acro(best)
    assert [stimulus.name for stimulus in best.stimuli] == ["ACRO", "MAV_CMD_DO_PARACHUTE"]
    assert best.stimuli[1].values == (2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert best.stimuli[1].at_s <= 1.5
    assert best.scenario.time_limit_s < 15.0
    assert len(flown) <= 120
    assert best.rng_seed == start.rng_seed


def test_the_result_does_not_depend_on_the_order_of_answers() -> None:
    steady, _ = shrink(twenty(), chute_in_acro)
    for shuffle in range(1, 6):
        shuffled, _ = shrink(twenty(), chute_in_acro, shuffle=shuffle)
        assert shuffled.best == steady.best


def test_no_test_case_is_given_out_twice_and_the_budget_holds() -> None:
    for flights_max in (0, 1, 5, 33):
        minimizer, flown = shrink(twenty(), chute_in_acro, flights_max)
        assert len(flown) == len({identity(each) for each in flown}) <= flights_max
        assert chute_in_acro(minimizer.best)
        assert minimizer.ask() == ()


@pytest.mark.parametrize("breaks", [lambda _: True, lambda _: False])
def test_it_ends_whatever_the_answers(breaks: Breaks) -> None:
    minimizer, _ = shrink(twenty(), breaks, flights_max=10_000)
    assert minimizer.done
    expected = 0 if breaks(twenty()) else 20
    assert len(minimizer.best.stimuli) == expected


def test_answers_that_were_not_asked_for_or_come_twice_are_ignored() -> None:
    minimizer = Minimizer(twenty(), 50, ONE_FLIGHT)
    batch = minimizer.ask()
    name = identity(batch[0].test_case)
    minimizer.tell("nobody", 0, True)
    minimizer.tell(name, 1, True)
    minimizer.tell(name, 0, False)
    minimizer.tell(name, 0, True)
    assert minimizer.ask() == batch[1:], "what is left of the generation"
    for each in batch[1:]:
        minimizer.tell(identity(each.test_case), 0, False)
    assert minimizer.best == twenty()


def test_two_inputs_that_need_each_other_are_both_kept() -> None:
    start = case(*(Stimulus(at_s=float(n), kind="parameter", name=f"P{n}", values=(1.0,)) for n in range(16)))

    def both(test_case: TestCase) -> bool:
        return {"P2", "P13"} <= {stimulus.name for stimulus in test_case.stimuli}

    minimizer, _ = shrink(start, both)
    assert [stimulus.name for stimulus in minimizer.best.stimuli] == ["P2", "P13"]


def test_a_smaller_case_names_the_one_it_came_from() -> None:
    start = twenty()
    minimizer, _ = shrink(start, chute_in_acro)
    assert minimizer.best.origin.parent == identity(start)
    assert minimizer.best.origin.note.startswith("shrunk")


def test_what_comes_after_the_violation_was_shown_is_flown_no_more() -> None:
    start = msgspec.structs.replace(twenty(), scenario=Scenario(start=StartState(), time_limit_s=120.0))
    whole, flown = shrink(start, chute_in_acro)
    shown, soon = shrink(start, chute_in_acro, shown_s=35.6)
    assert shown.best.stimuli == whole.best.stimuli
    assert soon[0].scenario.time_limit_s == 36.6
    assert max(stimulus.at_s for stimulus in soon[0].stimuli) <= 35.6
    assert all(each.scenario.time_limit_s <= 36.6 for each in soon[3:])
    assert 2 * sum(each.scenario.time_limit_s for each in soon) < sum(each.scenario.time_limit_s for each in flown)


@pytest.mark.parametrize("shown_s", [0.5, 20.0, 59.5, 1e9])
def test_a_moment_told_wrongly_costs_three_flights_at_most(shown_s: float) -> None:
    told, _ = shrink(twenty(), chute_in_acro, shown_s=shown_s)
    assert [one.name for one in told.best.stimuli] == ["ACRO", "MAV_CMD_DO_PARACHUTE"]
    assert len(Minimizer(twenty(), 200, ONE_FLIGHT, shown_s).ask()) <= 3


@pytest.mark.parametrize("shown_s", [-1e300, -3.0, 1e300, None])
def test_whatever_moments_were_told_each_flight_asked_for_can_be_read(shown_s: float | None) -> None:
    """An oracle says when a violation was shown, a mutator when inputs are given; nobody flies what he cannot read."""
    late = Stimulus(at_s=3.4e38, kind="command", name="B", values=(3.4e38, 1.0))
    odd = case(late, msgspec.structs.replace(late, at_s=-3.4e38), late, msgspec.structs.replace(late, at_s=-9.0))
    for violates in (lambda _: True, lambda _: False, lambda each: len(each.stimuli) > 1):
        _, flown = shrink(odd, violates, shown_s=shown_s)
        assert flown
        assert [wire.checked(each, TestCase) for each in flown] == flown


def test_a_mission_keeps_its_time_and_loses_what_was_given_later() -> None:
    flown = Mission(name="m", home_lat_deg=47.4, home_lon_deg=8.5, home_alt_m=400.0, items=())
    mission = Scenario(mission=flown, time_limit_s=60.0)
    start = msgspec.structs.replace(twenty(), scenario=mission)
    (first, *_) = Minimizer(start, 50, ONE_FLIGHT, 35.6).ask()
    assert first.test_case.scenario == mission
    assert len(first.test_case.stimuli) < len(start.stimuli)


def test_few_flights_are_flown_beside_one_that_violates() -> None:
    minimizer = Minimizer(twenty(), 200, ONE_FLIGHT)
    widths = []
    for _ in range(4):
        asked = minimizer.ask()
        widths.append(len(asked))
        for each in asked:
            minimizer.tell(identity(each.test_case), each.number, False)
    assert widths == [2, 4, 4, 4]
    asked = minimizer.ask()
    for each in asked:
        minimizer.tell(identity(each.test_case), each.number, True)
    assert len(minimizer.ask()) == 2


def test_inputs_that_were_enough_for_another_find_are_tried_first() -> None:
    enough = names_of(case(Stimulus(at_s=0.0, kind="mode", name="ACRO"), *twenty().stimuli[13:14]))
    minimizer = Minimizer(twenty(), 30, ONE_FLIGHT, enough=enough)
    first = minimizer.ask()[0].test_case
    assert [one.name for one in first.stimuli] == ["ACRO", "MAV_CMD_DO_PARACHUTE"]


@pytest.mark.parametrize("enough", [frozenset(), frozenset({"mode NOWHERE"}), names_of(twenty())])
def test_inputs_that_drop_none_or_all_are_no_test_case(enough: frozenset[str]) -> None:
    without = Minimizer(twenty(), 30, ONE_FLIGHT)
    assert Minimizer(twenty(), 30, ONE_FLIGHT, enough=enough).ask() == without.ask()


def test_a_find_within_documented_ranges_is_not_made_smaller_outside_of_them() -> None:
    stick = Stimulus(at_s=1.0, kind="stick", name="RC2", values=(877.3,))
    setting = Stimulus(at_s=0.5, kind="parameter", name="RTL_ALT", values=(8123.0,))
    inputs = (
        InputInfo(kind="stick", name="RC2", low=850.0, high=2200.0),
        InputInfo(kind="parameter", name="RTL_ALT", low=200.0, high=8000.0),  # it was outside before
    )
    start = case(setting, stick)
    ranges = ranges_kept(start, msgspec.structs.replace(describe(), inputs=inputs))
    assert ranges == {"stick RC2": (850.0, 2200.0)}

    def tried(ranges: dict[str, tuple[float, float]], name: str) -> set[float]:
        minimizer, found = Minimizer(start, 60, ONE_FLIGHT, ranges=ranges), set()
        while not minimizer.done:
            for flown, number in minimizer.ask():
                found |= {one.values[0] for one in flown.stimuli if one.name == name}
                minimizer.tell(identity(flown), number, len(flown.stimuli) == 2)
        return found

    assert 0.0 in tried({}, "RC2")
    assert tried(ranges, "RC2") == {877.3, 880.0, 900.0}
    assert 0.0 in tried(ranges, "RTL_ALT")
