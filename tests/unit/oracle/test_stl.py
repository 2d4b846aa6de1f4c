"""What goes beyond rtamt: crisp conditions, lasting, latch, ago, mean, turn, and judging only where windows fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from saflite.contract.errors import Refused
from saflite.contract.signals import MODES
from saflite.oracle.finding import Finding, find
from saflite.oracle.formula import Node
from saflite.oracle.parse import parse
from saflite.oracle.policy import crispened
from saflite.oracle.stl import Evaluator


def over(text: str, **signals: Sequence[float]) -> list[float]:
    given = {name: np.array(values) for name, values in signals.items()}
    return [float(value) for value in Evaluator(given, 1.0).trace(crispened(parse(text, MODES)))]


def found(text: str, **signals: Sequence[float]) -> Finding | None:
    given = {name: np.array(values) for name, values in signals.items()}
    return find(Evaluator(given, 1.0), crispened(parse(text, MODES)))


INF = float("inf")


def test_lasting_is_never_true_before_its_time() -> None:
    assert over("lasting[2] (mode == AUTO)", mode=[3, 3, 3, 3, 0, 3]) == [-INF, -INF, INF, INF, -INF, -INF]


def test_latch_keeps_the_value_of_the_moment() -> None:
    values = over("climb_mps - latch(climb_mps, mode == FLIP) <= 0", climb_mps=[1, 2, 5, 7, 8], mode=[2, 14, 14, 2, 14])
    assert values == [0, 0, -3, -5, 0]


def test_ago_mean_prev_rate_and_turn() -> None:
    assert over("climb_mps - ago(climb_mps, 2) <= 0", climb_mps=[1, 2, 4, 8]) == [0, -1, -3, -6]
    assert over("mean(climb_mps, 2) >= 0", climb_mps=[1, 2, 4, 8]) == [1, 1.5, 3, 6]
    assert over("climb_mps - prev(climb_mps) >= 0", climb_mps=[1, 2, 4, 8]) == [0, 1, 2, 4]
    assert over("rate(climb_mps) >= 0", climb_mps=[1, 2, 4, 8]) == [0, 1, 2, 4]
    assert over("turn(yaw_deg - 350) >= 0", yaw_deg=[10, 340, 170]) == [20, -10, -180]


def test_conditions_are_crisp_and_promises_have_a_margin() -> None:
    finding = found("always ((climb_mps > 0.999) implies altitude_m >= 10)", climb_mps=[0, 1, 1], altitude_m=[3, 8, 12])
    assert finding is not None
    assert (finding.robustness, finding.witness_from_s, finding.witness_to_s) == (-2, 1, 1)
    assert finding.applied_share == pytest.approx(2 / 3)


def test_nearness_counts_the_parts_of_a_condition_that_held_at_once() -> None:
    text = "always ((lasting[1] (mode == RTL and armed == 1) and altitude_m > 5) implies climb_mps > 0)"
    given = {"armed": [0, 1, 1, 0], "altitude_m": [1, 1, 1, 9], "climb_mps": [-1, -1, -1, -1]}
    for mode, nearness in (([0, 0, 0, 0], 1 / 3), ([0, 6, 6, 0], 2 / 3), ([0, 0, 0, 6], 2 / 3)):
        finding = found(text, mode=mode, **given)
        assert finding is not None
        assert (finding.applied_share, finding.nearness, finding.applied_from_s) == (0.0, nearness, None)


def test_the_first_moment_at_which_any_condition_of_a_rule_held_is_told() -> None:
    text = "always (((mode == RTL) implies climb_mps > 0) and ((lasting[1] armed == 1) implies climb_mps > 0))"
    for mode, armed, first_s in (([0, 0, 0, 6], [0, 1, 1, 0], 2.0), ([0, 6, 6, 0], [0, 0, 1, 1], 1.0)):
        finding = found(text, mode=mode, armed=armed, climb_mps=[1, 1, 1, 1])
        assert finding is not None
        assert finding.applied_from_s == first_s
    plain = found("always (climb_mps > 0)", climb_mps=[1, 1])
    assert plain is not None
    assert plain.applied_from_s is None


def test_a_promise_that_could_still_be_kept_is_not_judged() -> None:
    text = "always ((mode == RTL) implies eventually[0:3] (altitude_m >= 10))"
    short = found(text, mode=[0, 0, 6, 6, 6], altitude_m=[0, 0, 0, 0, 0])
    longer = found(text, mode=[0, 0, 6, 6, 6, 6], altitude_m=[0, 0, 0, 0, 0, 0])
    assert (short and short.robustness, longer and longer.robustness) == (INF, -10)
    assert found(text, mode=[6, 6], altitude_m=[0, 0]) is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "the end"),
        ("altitude_m", "a truth value, got a number|a comparison or a truth value"),
        ("always altitude_m", "comparison or a truth value"),
        ("(altitude_m > 1) + 2 > 3", "an operator or the end|numbers"),
        ("always[5:2] (altitude_m > 1)", "does not end before it begins"),
        ("always[x:2] (altitude_m > 1)", "a time in seconds"),
        ("altitude_m > 1 ?", "line 1 column 16"),
        ("foo(altitude_m) > 1", "a call of"),
        ("alwys (altitude_m > 1)", "did you mean always"),
        ("altitude_m > 1 AND climb_mps > 1", "got 'AND'; did you mean and"),
        ("altitude_m > 1 => climb_mps > 1", "line 1 column 16.*write implies"),
        ("altitude_m > 1 && climb_mps > 1", "line 1 column 16.*got '&&'; write and"),
        ("altitude_m > 1 || climb_mps > 1", "write or"),
        ("altitude_m = 1", "got '='; write =="),
        ("(" * 500 + "altitude_m > 1" + ")" * 500, "100 levels"),
        ("-" * 5000 + "1 > 0", "100 levels"),
        ("altitude_m >\n  and 3", "line 2 column 3"),
        ("altitude_m / 0 > 3", "a divisor other than 0"),
    ],
)
def test_faults_are_told_with_their_place(text: str, reason: str) -> None:
    with pytest.raises(Refused, match=reason):
        parse(text)


def test_a_division_by_zero_says_nothing_unless_the_condition_rules_it_out() -> None:
    signals = {"altitude_m": [4.0, 4.0, 4.0], "climb_mps": [2.0, 0.0, 1.0]}
    plain = found("always (altitude_m / climb_mps <= 5)", **signals)
    assert plain
    assert np.isnan(plain.robustness)
    guarded = found("always (climb_mps > 0 implies altitude_m / climb_mps <= 3)", **signals)
    assert guarded
    assert guarded.robustness == -1.0


@pytest.mark.parametrize("unknown", [0, 1, 5])
def test_what_is_not_known_hides_no_violation_elsewhere(unknown: int) -> None:
    heights = [20.0, 20.0, -3.0, -8.0, 20.0, 20.0]
    heights[unknown] = np.nan
    broken = found("always altitude_m > 0", altitude_m=heights)
    assert broken
    assert (broken.robustness, broken.witness_from_s, broken.witness_to_s) == (-8.0, 2.0, 3.0)
    open_ = found("always altitude_m > -9", altitude_m=heights)
    assert open_
    assert np.isnan(open_.robustness)


def test_a_missing_signal_is_refused() -> None:
    with pytest.raises(Refused, match="climb_mps"):
        Evaluator({"altitude_m": np.zeros(3)}, 1.0).trace(Node("signal", name="climb_mps"))


def test_a_gap_hides_the_means_it_is_in_and_no_later_ones() -> None:
    """A hole in a log, where a sum was kept: nothing was known of the rest of the flight."""
    heights = np.array([1.0, np.nan, 3.0, 5.0, 7.0])
    told = Evaluator({"altitude_m": heights}, 1.0).trace(parse("mean(altitude_m, 2) >= 0").args[0])
    assert np.array_equal(told, [1.0, np.nan, np.nan, 4.0, 6.0], equal_nan=True)
