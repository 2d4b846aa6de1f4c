"""The same flight by another radio: what is shifted, what must not be, and that the reference flies it bit by bit."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase, identity
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.autopilots.reference.radio import Radio
from saflite.oracle.judge import judge
from saflite.simulator_worker.recalibrated import SHIFTS_US, recalibrated

INPUTS = describe().inputs


def given(at_s: float, kind: StimulusKind, name: str, *values: float) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)


def case(*stimuli: Stimulus, height_m: float = 20.0, parameters: dict[str, float] | None = None) -> TestCase:
    start = StartState(mode="LOITER", altitude_m=height_m)
    scenario = Scenario(start=start, time_limit_s=20.0)
    target = Target(parameters=parameters or {})
    return TestCase(target=target, scenario=scenario, stimuli=stimuli, rng_seed=3, twin="recalibrated")


def shifted(test_case: TestCase) -> dict[str, list[float]]:
    """Return what each name is given, in order."""
    second = recalibrated(test_case, INPUTS)
    assert second is not None
    found: dict[str, list[float]] = {}
    for one in second.stimuli:
        found.setdefault(one.name, []).extend(one.values)
    return found


def test_pulses_and_calibrations_are_halved_and_shifted_together() -> None:
    found = shifted(case(given(1, "stick", "RC1", 1700), given(2, "parameter", "RC1_MAX", 1900)))
    by = SHIFTS_US["RC1"]
    assert found["RC1"] == [1500 + by, 1600 + by]
    assert found["RC1_MAX"] == [1750 + by, 1700 + by]
    assert (found["RC1_MIN"], found["RC1_TRIM"], found["RC1_DZ"]) == ([1250 + by], [1500 + by], [10])


def test_the_dead_zone_of_the_throttle_is_halved_with_its_span() -> None:
    found = shifted(case(given(1, "stick", "RC3", 1700), given(2, "parameter", "THR_DZ", 60)))
    by = SHIFTS_US["RC3"]
    assert (found["THR_DZ"], found["RC3"]) == ([50, 30], [1500 + by, 1600 + by])


@pytest.mark.parametrize(("name", "value"), [("RC1_MAX", 1901.0), ("RC1_MIN", 1400.0), ("RC1_DZ", 15.0)])
def test_a_stick_whose_halves_are_not_whole_or_do_not_fit_is_shifted_alone(name: str, value: float) -> None:
    found = shifted(case(given(1, "stick", "RC1", 1700), given(2, "parameter", name, value)))
    assert abs(found["RC1"][-1] - 1700) == SHIFTS_US["RC1"]
    assert found["RC1_DZ"][0] == 20


def test_settings_before_the_start_count() -> None:
    second = recalibrated(case(parameters={"RC2_TRIM": 1450.0, "RTL_ALT": 900.0}), INPUTS)
    assert second is not None
    assert second.target.parameters == {"RTL_ALT": 900.0}
    assert [one.values for one in second.stimuli if one.name == "RC2_TRIM"] == [(1505.0,)], (
        "the other way: 1445 is refused"
    )


def test_a_stick_whose_calibrations_leave_no_room_stays() -> None:
    found = shifted(case(given(1, "parameter", "RC4_TRIM", 1450), given(2, "parameter", "RC4_TRIM", 1550)))
    assert found["RC4_TRIM"] == [1450, 1550]
    assert "RC4" not in found


@pytest.mark.parametrize(
    "stimuli",
    [
        (given(1, "stick", "RC3", 960),),  # a lost radio, with 25 us more it is none
        (given(1, "parameter", "FS_THR_VALUE", 1090), given(2, "stick", "RC3", 1080)),
        (given(1, "stick", "RC3", 1490), given(2, "mode", "FLIP")),
    ],
)
def test_a_throttle_whose_pulse_means_something_by_itself_passes_it_by_no_shift(stimuli: tuple[Stimulus, ...]) -> None:
    pulse = next(one.values[0] for one in stimuli if one.name == "RC3")
    lost = next((one.values[0] for one in stimuli if one.name == "FS_THR_VALUE"), 975.0)
    mark = 1500.0 if any(one.name == "FLIP" for one in stimuli) else lost
    after = shifted(case(*stimuli))["RC3"][-1]
    assert (after < mark) == (pulse < mark)


@pytest.mark.parametrize(("least", "moves"), [(800.0, False), (970.0, False), (990.0, True)])
def test_a_throttle_whose_way_holds_the_pulse_of_a_lost_radio_stays(least: float, moves: bool) -> None:
    lost = given(2, "sensor_fault", "SIM_RC_FAIL", 2)
    stimuli = (given(1, "parameter", "FS_THR_ENABLE", 0), given(1, "parameter", "RC3_MIN", least), lost)
    flown = case(*stimuli, given(3, "mode", "STABILIZE"))
    assert ("RC3" in shifted(flown)) == moves
    trace = fly_once(flown).trace
    assert trace is not None
    assert not np.any(trace.array("twin_height_apart_m"))


def test_on_the_ground_the_throttle_stays() -> None:
    assert "RC3" not in shifted(case(given(1, "stick", "RC1", 1700), height_m=0.0))


def test_what_was_refused_is_given_as_it_is() -> None:
    test_case = case(given(1, "parameter", "RC1_TRIM", 1560), given(2, "stick", "RC1", 1700))
    second = recalibrated(test_case, INPUTS, {0})
    assert second is not None
    assert [one.values for one in second.stimuli if one.name == "RC1_TRIM"] == [(1540.0,), (1560.0,)]


STICKS = (
    given(1, "stick", "RC1", 1640),
    given(2, "stick", "RC3", 1610),
    given(3, "mode", "STABILIZE"),
    given(4, "stick", "RC4", 1300),
    given(5, "stick", "RC3", 1480),
    given(7, "sensor_fault", "SIM_RC_FAIL", 1),
    given(11, "sensor_fault", "SIM_RC_FAIL", 0),
)


def test_the_reference_flies_the_same_bit_by_bit() -> None:
    trace = fly_once(case(*STICKS)).trace
    assert trace is not None
    apart = [trace.array(name) for name in trace.signals if name.startswith("twin_")]
    assert not np.any(apart)
    assert np.all(trace.array("twin") == 5.0)


def test_a_span_that_is_taken_for_that_of_another_radio_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    def fixed(self: Radio) -> float:
        return min(1.0, max(0.0, (self.throttle_filtered - self._parameters["RC3_MIN"]) / 1000.0))

    monkeypatch.setattr(Radio, "throttle", fixed)
    flown = case(given(0.5, "mode", "STABILIZE"), given(1, "stick", "RC3", 1560), given(3, "stick", "RC3", 1500))
    record = fly_once(flown)
    flight = Flight(test_case=identity(flown), flight_index=0, ending=record.ending, delivered=record.delivered)
    assert judge(flown, flight, record.trace, ("radio-alike",)).verdicts[0].outcome == "violated"


def test_a_radio_that_centres_elsewhere_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    def fixed(self: Radio, channel: int) -> float:
        return max(-1.0, min(1.0, (self.received[channel] - 1500.0) / 500.0))

    monkeypatch.setattr(Radio, "deflection", fixed)
    flown = msgspec.structs.replace(case(*STICKS[:1]))
    record = fly_once(flown)
    flight = Flight(test_case=identity(flown), flight_index=0, ending=record.ending, delivered=record.delivered)
    assert judge(flown, flight, record.trace, ("radio-alike",)).verdicts[0].outcome == "violated"
