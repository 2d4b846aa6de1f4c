"""What holds of orders and settings over a flight is told as by going through them one by one, and in one look."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from saflite.contract.flight import Given
from saflite.contract.rng import derive
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase
from saflite.oracle import orders
from saflite.oracle.courses import set_last, within
from saflite.oracle.effects import undisturbed

TIMES = np.arange(400, dtype=np.float64) * 0.05
CASE = TestCase(target=Target(name="ardupilot"), scenario=Scenario())


def test_what_was_set_last_holds_from_then_on() -> None:
    rng = derive(1, "set last")
    for many in (0, 1, 40):
        changes = [(float(at_s), float(rng.normal())) for at_s in np.sort(rng.choice(TIMES, many))]
        expected = np.full(len(TIMES), 7.0)
        for at_s, value in changes:
            expected[at_s <= TIMES] = value
        assert set_last(changes, np.full(len(TIMES), 7.0), TIMES).tolist() == expected.tolist()


def test_spans_last_from_their_begin_on_until_before_their_end() -> None:
    rng = derive(1, "within")
    for many in (0, 1, 40):
        spans = [(float(at_s), float(at_s + rng.uniform(-0.5, 0.5))) for at_s in rng.choice(TIMES, many)]
        spans += [(19.0, np.inf), (-np.inf, 0.1), (5.0, 5.05)]
        expected = np.zeros(len(TIMES), dtype=bool)
        for begin_s, end_s in spans:
            expected |= (begin_s <= TIMES) & (end_s > TIMES)
        assert within(spans, TIMES).tolist() == expected.tolist()


class Compared(np.ndarray[Any, Any]):
    """An array that counts how often it is compared with a moment."""

    looks = 0

    def __ge__(self, other: Any) -> Any:
        Compared.looks += 1
        return super().__ge__(other)


def _given(kind: Any, name: str, values: Callable[[int], tuple[float, ...]]) -> list[Given]:
    made = (Stimulus(at_s=0.1 * at, kind=kind, name=name, values=values(at)) for at in range(100))
    return [Given(one, "accepted") for one in made]


SETTING = _given("parameter", "WPNAV_SPEED", lambda at: (100.0 + at,))
FAULTS = _given("parameter", "SIM_GPS_DISABLE", lambda at: (float(at % 2),))
ZEROS = np.zeros(len(TIMES))
ORDERED: dict[str, Callable[[Any], Any]] = {
    "a setting": lambda times: orders.setting_over_time("cruise_speed_set_mps", CASE, SETTING, times),
    "a speed": lambda times: orders.speed_ordered(
        _given("command", "DO_CHANGE_SPEED", lambda at: (0.0, 1.0 + at)), ZEROS, times
    ),
    "a pause": lambda times: orders.paused(_given("command", "DO_PAUSE_CONTINUE", lambda at: (at % 2.0,)), times),
    "home": lambda times: orders.home_off(
        CASE, _given("command", "DO_SET_HOME", lambda at: (1.0,)), (TIMES, TIMES, ZEROS), times
    ),
    "a disturbance": lambda times: undisturbed("gps_settled", [one.stimulus for one in FAULTS], {}, times),
}


@pytest.mark.parametrize("what", ORDERED)
def test_many_orders_are_not_held_against_all_moments_one_by_one(what: str) -> None:
    """10 MB of a log in which settings change at every sample took hours; so did a test case of 100,000 stimuli."""
    before = Compared.looks
    told = ORDERED[what](TIMES.view(Compared))
    assert len(set(np.asarray(told).tolist())) > 1, "they count"
    assert Compared.looks - before < 5
