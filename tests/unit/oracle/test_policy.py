from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, Trace
from saflite.contract.signals import MODES
from saflite.contract.test_case import Scenario, Target, TestCase, identity
from saflite.contract.work import PolicyText
from saflite.oracle import formula
from saflite.oracle.judge import judge
from saflite.oracle.parse import parse
from saflite.oracle.policy import load_policy, parse_policy

GOOD = """id = "test"
title = "Stay low"
source = "test"
interestingness = "words"
formula = "always ((mode == AUTO) implies altitude_m <= ceiling_m)"

[constants]
ceiling_m = 10.0

[signals]
altitude_m = "m"
mode = ""

[[examples]]
holds = true
why = "low"
duration_s = 5.0
signals = { mode = "AUTO", altitude_m = 5 }

[[examples]]
holds = false
why = "high"
duration_s = 5.0
signals = { mode = "AUTO", altitude_m = [[0, 5], [5, 15]] }
"""
HOLDS = 'signals = { mode = "AUTO", altitude_m = 5 }'


def test_a_good_policy_loads() -> None:
    policy = parse_policy(GOOD, "test.toml")
    assert (policy.id, policy.unit) == ("test", "m")
    assert policy.needed == {"mode", "altitude_m"}


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("altitude_m <= ceiling_m)", "hight_m <= ceiling_m)", r"signal \(test.toml line 5\).*'hight_m'"),
        ('altitude_m = "m"', 'altitude_m = "ft"', r"unit of altitude_m \(test.toml line 11\): expected 'm', got 'ft'"),
        ('altitude_m = "m"\n', "", r"'altitude_m' with its unit"),
        ('mode = ""', 'mode = ""\nclimb_mps = "m/s"', r"line 13\): expected only signals the formula reads"),
        (
            "altitude_m <= ceiling_m)",
            "eventually (altitude_m <= ceiling_m))",
            r"line 5\): expected a window \[from:to\]",
        ),
        ("altitude_m <= ceiling_m)", "altitude_m <= )", r"formula \(test.toml line 5, formula line 1 column 46\)"),
        (
            "ceiling_m = 10.0",
            "ceiling_m = 3.0",
            r"example 1 \(test.toml line 14\): expected to hold \(low\).*robustness -2",
        ),
        (
            "ceiling_m = 10.0",
            "ceiling_m = 10.0\n\n[constants_on.reference]\nfloor_m = 1.0",
            r"constants_on \(test.toml line 10\): expected names that stand under \[constants\], got 'floor_m'",
        ),
        (
            "ceiling_m = 10.0",
            "ceiling_m = 10.0\n" + "".join(f"[constants_on.t{n}]\nceiling_m = 9.0\n" for n in range(17)),
            r"expected constants_on for at most 16 targets, got 17",
        ),
        ("ceiling_m = 10.0", "ceiling_m = 30.0", r"example 2 \(test.toml line 20\): expected to violate \(high\)"),
        (HOLDS, 'signals = { mode = "RTL", altitude_m = 5 }', r"expected the rule to apply"),
        (HOLDS, 'signals = { mode = "AUTO" }', r"altitude_m amiss"),
        (HOLDS, 'signals = { mode = "WALK", altitude_m = 5 }', r"a mode by name"),
        (HOLDS, "signals = { mode = 'RTL', altitude_m = { mean = 5, size = 1, period_s = 0 } }", r"period_s"),
        ("holds = false", "holds = true", r"one that holds and one that violates.*, got holds = true only"),
        ("ceiling_m = 10.0", "ceilin_m = 10.0", r"got 'ceiling_m'; did you mean ceilin_m\?"),
        ('title = "Stay low"', 'titel = "Stay low"', r"test.toml line 2"),
        ('id = "test"', "id = test", r"expected TOML"),
        ("altitude_m <= ceiling_m)", "altitude_m <= mode)", r"one unit on both sides of '<='.*\[m\] and mode \[\]"),
    ],
)
def test_bad_policies_are_refused_with_line_and_reason(old: str, new: str, reason: str) -> None:
    assert old in GOOD
    with pytest.raises(Refused, match=reason):
        parse_policy(GOOD.replace(old, new, 1), "test.toml")


@pytest.mark.parametrize("op", ["iff", "xor"])
def test_a_rule_is_no_longer_made_crisp_than_written_out(op: str) -> None:
    """Each `iff` of comparisons that are true or false names both its sides twice once it is made crisp: what walks
    through the rule took two to the power of their number of steps."""
    condition = "armed == 1"
    for _ in range(40):
        condition = f"(mode == AUTO {op} {condition})"
    text = GOOD.replace("(mode == AUTO)", condition).replace('mode = ""', 'mode = ""\narmed = ""')
    text = text.replace("[[examples]]", '[inputs]\nsensor_faults = ["SIM_GPS1_NOISE"]\n\n[[examples]]', 1)
    with pytest.raises(Refused, match=r"at most (10000 parts|\d+ levels)"):
        parse_policy(text, "test.toml")


def test_examples_take_over_from_each_other_however_many_there_are() -> None:
    """Each was completed by a call within the call of the one after it: more than the stack holds."""
    first = "[[examples]]\nholds = true\nwhy = 'low'\nduration_s = 5.0\n"
    text = GOOD + "".join(f"\n{first}like = {number if number > 2 else 1}\n" for number in range(2, 999))
    assert len(parse_policy(text, "test.toml").file.examples) == 999
    with pytest.raises(Refused, match=r"example 3 like.*an earlier one"):
        parse_policy(f"{GOOD}\n{first}like = 3\n", "test.toml")


def test_constants_of_a_target_hold_for_its_flights_alone() -> None:
    """A log of the same autopilot, and flights of others, are judged by the wider ones."""
    text = GOOD.replace("ceiling_m = 10.0", "ceiling_m = 10.0\n\n[constants_on.reference]\nceiling_m = 6.0")
    climbs = np.linspace(5.0, 8.0, 50)
    flown = {"mode": np.full(50, MODES["AUTO"]), "altitude_m": climbs}
    trace = Trace(step_s=0.1, signals={name: values.astype("<f4").tobytes() for name, values in flown.items()})

    def worth(target: str, sources: dict[str, str] | None = None) -> float:
        case = TestCase(target=Target(name=target), scenario=Scenario())
        flight = Flight(test_case=identity(case), flight_index=0, ending="completed")
        texts = {"low.toml": PolicyText(text=text, file="low.toml")}
        robustness = judge(case, flight, trace, ("low.toml",), texts, sources).verdicts[0].robustness
        assert robustness is not None
        return robustness

    assert worth("reference") == pytest.approx(-2.0)
    assert worth("px4") == worth("reference", {}) == pytest.approx(2.0)


def test_unknown_names_and_files_are_refused() -> None:
    with pytest.raises(Refused, match="policy"):
        load_policy("no-such-policy")
    with pytest.raises(Refused, match="policy file"):
        load_policy("missing.toml")


def test_texts_without_number_fill_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Formulas that came with work were kept for good, each of their parts once."""
    monkeypatch.setattr(formula, "_ONE", {})
    monkeypatch.setattr(formula, "_REACH", {})
    monkeypatch.setattr(formula, "KEPT_MAX", 50)
    for number in range(100):
        text = f"eventually[0:{number}] (altitude_m > {number} and climb_mps < {number})"
        node = formula.interned(parse(text))
        assert formula.reach_s(node) == float(number)
    assert len(formula._ONE) < 70
    assert len(formula._REACH) < 70
