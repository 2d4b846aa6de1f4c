"""Events of one instant have an order: no rule takes them for each other, whether 0, 1 or 2 ticks apart.

`scripts/bench edges` flies many more of them.
"""

from __future__ import annotations

from itertools import islice, product

import disturbed_cases
import edge_cases
import msgspec
import pytest
from thinned import thinned

from saflite.contract.errors import Refused
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.autopilots.reference.autopilot import TICK_S
from saflite.flight.autopilots.reference.defects import trigger

RELEASE = ("command", "MAV_CMD_DO_PARACHUTE", (2.0,))
FLIP, HOLD = (("mode", name, ()) for name in ("FLIP", "ALT_HOLD"))
LOWER = ("parameter", "CHUTE_ALT_MIN", (0.0,))
CHUTE = {"CHUTE_ENABLED": 1.0}


def flown(start: StartState, parameters: dict[str, float], *inputs: tuple[float, tuple[object, ...]]) -> TestCase:
    stimuli = tuple(Stimulus(at_s=round(at, 6), kind=k, name=n, values=v) for at, (k, n, v) in inputs)  # type: ignore[arg-type]
    scenario = Scenario(start=start, time_limit_s=4.0)
    return TestCase(target=Target(parameters=parameters), scenario=scenario, stimuli=stimuli)


@pytest.mark.parametrize("gap", [0, 1, 2])
def test_a_parachute_after_the_flip_was_left_is_no_violation(gap: int) -> None:
    start, after_s = StartState(mode="ALT_HOLD", altitude_m=50.0), 1.0 + gap * TICK_S
    assert edge_cases.broken(flown(start, CHUTE, (0.0, FLIP), (1.0, HOLD), (after_s, RELEASE))) == []


@pytest.mark.parametrize("gap", [0, 1, 2])
def test_a_flip_after_a_mode_it_may_be_entered_from_is_no_violation(gap: int) -> None:
    start = StartState(mode="GUIDED", altitude_m=30.0)
    assert edge_cases.broken(flown(start, {}, (1.0, HOLD), (1.0 + gap * TICK_S, FLIP))) == []


@pytest.mark.parametrize("gap", [0, 1, 2])
def test_a_parachute_after_its_least_height_was_lowered_is_no_violation(gap: int) -> None:
    start, after_s = StartState(mode="ALT_HOLD", altitude_m=20.0), 1.0 + gap * TICK_S
    high = {**CHUTE, "CHUTE_ALT_MIN": 90.0}
    assert edge_cases.broken(flown(start, high, (1.0, LOWER), (after_s, RELEASE))) == []


@pytest.mark.parametrize(("after", "gap"), list(product([HOLD, LOWER], [0, 1, 2])))
def test_a_release_in_a_forbidden_mode_counts_though_the_mode_is_left_in_the_same_instant(
    after: tuple[object, ...], gap: int
) -> None:
    case = trigger("parachute-in-acro")
    (release,) = case.stimuli
    later = Stimulus(at_s=round(1.0 + gap * TICK_S, 6), kind=after[0], name=after[1], values=after[2])  # type: ignore[arg-type]
    assert any(told.startswith("a-chute") for told in edge_cases.broken(with_inputs(case, release, later)))


def test_a_flip_from_a_forbidden_mode_counts_though_allowed_modes_come_just_before_and_after() -> None:
    case = trigger("flip-from-any-mode")
    modes = [Stimulus(at_s=1.0, kind="mode", name=name) for name in ("ALT_HOLD", "GUIDED", "FLIP", "ALT_HOLD")]
    assert any(told.startswith("a-flip1") for told in edge_cases.broken(with_inputs(case, *modes)))


def with_inputs(case: TestCase, *stimuli: Stimulus) -> TestCase:
    return msgspec.structs.replace(case, stimuli=stimuli)


@pytest.mark.parametrize("campaign", thinned([(name,) for name in edge_cases.campaigns()], each=2))
def test_inputs_that_meet_break_no_rule(campaign: str) -> None:
    case = next(edge_cases.meetings(campaign))
    assert edge_cases.broken(case) == [], case.stimuli


@pytest.mark.parametrize("campaign", ["policy-gps-failsafe-action", "policy-a-rc-fs2"])
def test_inputs_that_meet_a_change_of_the_autopilots_own_break_no_rule(campaign: str) -> None:
    for case in islice(edge_cases.reactions(campaign), 2):
        assert edge_cases.broken(case) == [], case.stimuli


@pytest.mark.live
@pytest.mark.parametrize("rng_seed", [3, 4])
def test_a_procedure_that_is_disturbed_breaks_no_rule(rng_seed: int) -> None:
    for what, case in islice(disturbed_cases.disturbed(rng_seed), 25):
        assert edge_cases.broken(case) == [], what


def test_what_disturbs_is_drawn_from_the_inputs_named() -> None:
    for _, case in islice(disturbed_cases.disturbed(1, "^GPS_POS1_[XY]$"), 10):
        assert any(one.name in ("GPS_POS1_X", "GPS_POS1_Y") for one in case.stimuli)
    with pytest.raises(Refused, match="NOWHERE"):
        next(disturbed_cases.disturbed(1, "NOWHERE"))
