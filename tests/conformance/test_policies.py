"""Every policy file: what loading checks, and what it does not."""

from __future__ import annotations

import re

import pytest

from saflite.contract.signals import MODES
from saflite.flight.autopilots.betaflight.switches import MODES as BETAFLIGHT_MODES
from saflite.oracle.examples import completed, example_signals
from saflite.oracle.finding import find
from saflite.oracle.policy import (
    POLICIES_DIR,
    family,
    load_policy,
    parse_policy,
    policy_names,
    reach_s_of,
    signal_table,
)
from saflite.oracle.stl import Evaluator

PUBLISHED = """
A.CHUTE A.RTL1 A.RTL2 A.RTL3 A.RTL4 A.FLIP1 A.FLIP2 A.FLIP3 A.FLIP4 A.ALT_HOLD1 A.ALT_HOLD2 A.CIRCLE1
A.CIRCLE2 A.CIRCLE3 A.CIRCLE4_6 A.CIRCLE7 A.LAND1 A.LAND2 A.AUTO1 A.GPS.FS1 A.GPS.FS2 A.RC.FS1 A.RC.FS2
A.SPORT1 A.GUIDED1 A.LOITER1 A.DRIFT1 A.BRAKE1 PX.CHUTE PX.RTL1 PX.RTL2 PX.RTL3 PX.RTL4 PX.RTL5 PX.ALTITUDE1
PX.HOLD1 PX.HOLD2 PX.POSITION1 PX.TAKEOFF1 PX.TAKEOFF2 PX.LAND1 PX.ORBIT1 PX.ORBIT2 PX.ORBIT3 PX.ORBIT4_5
PX.ORBIT6 PX.GPS.FS1 PX.GPS.FS2 PX.GPS.FS3
"""
KNOWN_MODES = set(MODES) | set(BETAFLIGHT_MODES)


NAMED_IN_THE_RULE = {
    "EK2_ALT_SOURCE": {"a-alt-hold1"},
    "CHUTE_ALT_MIN": {"a-chute", "px-chute"},
    "FS_EKF_ACTION": {"a-drift1", "gps-failsafe-action"},
    "LAND_ALT_LOW": {"a-land1", "a-land2", "px-land1"},
    "LAND_SPEED": {"a-land2", "px-land1"},
    "LAND_SPEED_HIGH": {"a-land1"},
    "WPNAV_SPEED_DN": {"a-land1"},
    "FS_THR_VALUE": {"a-rc-fs1", "a-rc-fs2"},
    "RTL_ALT_FINAL": {"a-rtl3"},
    "RTL_DESCEND_ALT": {"px-rtl3", "px-rtl4"},
    "RTL_LAND_DELAY": {"px-rtl4"},
    "PILOT_SPEED_UP": {"a-sport1"},
    "BATT_LOW_VOLT": {"battery-failsafe"},
    "BATT_LOW_TIMER": {"battery-failsafe"},
    "FENCE_ALT_MAX": {"fence-ceiling"},
    "COM_POS_FS_DELAY": {"px-gps-fs1"},
    "MIS_LTRMIN_ALT": {"px-hold2"},
}
"""Inputs that a rule cannot be said without. Scorers read these texts: any other name in one would be a give-away."""


@pytest.mark.parametrize("name", policy_names())
def test_a_text_names_no_input_but_those_of_its_rule(name: str) -> None:
    named = set(re.findall(r"\b[A-Z][A-Z0-9]*_[A-Z0-9_]+\b", load_policy(name).file.interestingness)) - set(MODES)
    assert {word for word in named if name not in NAMED_IN_THE_RULE.get(word, set())} == set()


def test_all_49_published_policies_are_there() -> None:
    published = [load_policy(name).file.published for name in policy_names()]
    wanted = PUBLISHED.split()
    assert len(wanted) == 49
    assert sorted(name for name in published if name) == sorted(wanted)


@pytest.mark.parametrize("name", policy_names())
def test_policy_file(name: str) -> None:
    policy = load_policy(name)
    text = (POLICIES_DIR / f"{name}.toml").read_text(encoding="utf-8")
    file = parse_policy(text, name).file  # refuses contradicted examples, which a shipped one is not loaded with
    assert file == policy.file
    assert name == name.lower() == file.id
    assert file.title
    assert len(file.interestingness.split()) >= 15
    assert "interesting" in file.interestingness
    assert file.state
    assert file.start is None or file.start.mode in KNOWN_MODES
    assert file.start is not None or file.needs_mission or file.inputs.obstacles
    assert set(file.inputs.modes) <= KNOWN_MODES
    assert all(len(reason) > 15 for reason in file.not_checked_on.values())
    assert reach_s_of(policy) <= 30.0
    published = family(file) in ("ArduPilot", "PX4")
    assert bool(file.published) == published
    assert not published or file.deviations, "what was mended against the published check"
    assert len(set(file.deviations)) == len(file.deviations), "each is told once"


def test_at_least_forty_policies_can_be_checked_on_the_reference() -> None:
    checked = [name for name in policy_names() if "reference" not in load_policy(name).file.not_checked_on]
    assert len(checked) >= 40


NARROWED = [(name, target) for name in policy_names() for target in sorted(load_policy(name).narrowed)]


@pytest.mark.parametrize(("name", "target"), NARROWED)
def test_what_breaks_a_rule_breaks_it_by_narrower_constants_too(name: str, target: str) -> None:
    policy = load_policy(name)
    examples, table = list(policy.file.examples), signal_table(policy.file)
    for number in range(1, len(examples) + 1):
        example = examples[number - 1] = completed(examples, number, name)
        if not example.holds:
            signals = example_signals(example, policy.signals, name, name, table)
            finding = find(Evaluator(signals, example.step_s), policy.on(target).formula)
            assert finding is not None, example.why
            assert finding.robustness < 0, example.why
