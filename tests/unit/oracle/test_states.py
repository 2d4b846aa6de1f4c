"""Steps through a target's states: inputs and changes in order, failsafes raised and recovered, denied inputs."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from saflite.contract.flight import Delivered, Flight, Trace
from saflite.contract.signals import MODES, SIGNALS
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import Judgement, Transition, Verdict
from saflite.contract.wire import decode, encode
from saflite.oracle.behaviour import behaviour_of
from saflite.oracle.judge import judge
from saflite.oracle.signals import FlightSignals
from saflite.oracle.states import transitions_of

STEP_S = 0.1
LOITER, RTL = "LOITER", "RTL"


def trace(**signals: list[tuple[float, float]]) -> Trace:
    """Ten seconds of signals, each given as (from second, value)."""
    times = np.arange(100) * STEP_S
    made = {}
    for name, steps in signals.items():
        values = np.zeros(len(times), dtype="<f4")
        for from_s, value in steps:
            values[times >= from_s - 1e-9] = value
        made[name] = values.tobytes()
    return Trace(step_s=STEP_S, signals=made)


def steps(
    stimuli: list[Stimulus], delivered: tuple[Delivered, ...] | None = None, **signals: object
) -> list[Transition]:
    case = TestCase(target=Target(), scenario=Scenario(), stimuli=tuple(stimuli))
    flight = Flight(test_case="", flight_index=0, ending="completed", delivered=delivered)
    return list(transitions_of(case, flight, FlightSignals(case, flight, trace(**signals))))  # type: ignore[arg-type]


def stick(at_s: float) -> Stimulus:
    return Stimulus(at_s=at_s, kind="stick", name="RC1", values=(1600.0,))


def test_an_input_leads_to_the_next_state_and_later_changes_have_none() -> None:
    mode = [(0.0, MODES[LOITER]), (2.1, MODES[RTL]), (5.0, MODES["LAND"])]
    rtl = Stimulus(at_s=2.0, kind="mode", name=RTL)
    found = steps([stick(1.0), rtl], mode=mode)
    assert found == [
        Transition(LOITER, LOITER, 0, -1),
        Transition(LOITER, RTL, 1, 0),
        Transition(RTL, "LAND", -1, 1),
    ]


def test_failsafes_standing_and_disarmed_are_told_when_raised_and_when_recovered() -> None:
    signals = {
        "mode": [(0.0, MODES[LOITER])],
        "armed": [(0.0, 1.0), (8.0, 0.0)],
        "landed": [(0.0, 0.0), (7.0, 1.0)],
        "failsafe_gps": [(0.0, 0.0), (3.0, 1.0), (5.0, 0.0)],
    }
    found = steps([], None, **signals)
    assert [step.after for step in found] == ["LOITER gps", LOITER, "LOITER standing", "LOITER standing disarmed"]
    assert all(step.stimulus == -1 for step in found)


def test_a_denied_input_is_no_step_and_two_of_one_instant_come_in_order() -> None:
    stimuli = [stick(1.0), stick(2.0), stick(2.0)]
    answers = (
        Delivered(index=0, at_s=1.0, answer="denied"),
        Delivered(index=1, at_s=2.0),
        Delivered(index=2, at_s=2.0),
    )
    found = steps(stimuli, answers, mode=[(0.0, MODES[LOITER]), (2.1, MODES[RTL])])
    assert found == [Transition(LOITER, LOITER, 1, -1), Transition(LOITER, RTL, 2, 1)]


def test_a_trace_without_modes_has_no_steps_and_an_unknown_mode_keeps_its_number() -> None:
    assert steps([stick(1.0)], x_m=[(0.0, 1.0)]) == []
    assert steps([stick(1.0)], mode=[(0.0, 99.0)]) == [Transition("mode 99", "mode 99", 0, -1)]


@pytest.mark.parametrize("value", [-1.0, -3.4e38, 3.4e38, np.inf, -np.inf, np.nan, 1e9])
@pytest.mark.parametrize("names", [("mode",), tuple(SIGNALS)])
def test_whatever_a_trace_holds_its_judgement_can_be_read(value: float, names: tuple[str, ...]) -> None:
    """A mode below 0, as logs of PX4 have of modes without a name, made a state of letters that no message may hold:
    the books could not read the judgement, and the violation in it was lost."""
    course = np.array([0.0] * 20 + [value] * 20, "<f4").tobytes()
    held = {name: course if name in names else bytes(160) for name in SIGNALS}
    case = TestCase(target=Target(), scenario=Scenario())
    flight = Flight(test_case=identity(case), flight_index=0, ending="crashed")
    with warnings.catch_warnings(action="ignore"):
        judgement = judge(case, flight, Trace(step_s=STEP_S, signals=held), ("upright", "a-chute", "fence-kept"))
    assert judgement.transitions or np.isnan(value)
    assert decode(encode(judgement), Judgement) == judgement


def test_inputs_delivered_at_no_time_of_a_flight_are_taken_for_its_first_or_last() -> None:
    late = tuple(Delivered(index=index, at_s=at_s) for index, at_s in enumerate((-1e300, 1e300)))
    found = steps([stick(1.0), stick(2.0)], late, mode=[(0.0, MODES[LOITER])])
    assert found == [Transition(LOITER, LOITER, 0, -1), Transition(LOITER, LOITER, 1, 0)]


def test_a_violation_while_the_mode_is_no_number_is_told_all_the_same() -> None:
    for value in (np.nan, np.inf):
        case = TestCase(target=Target(), scenario=Scenario())
        flight = Flight(test_case="", flight_index=0, ending="completed")
        signals = FlightSignals(case, flight, trace(mode=[(0.0, value)]))
        verdict = Verdict(policy="p", outcome="violated", robustness=-1.0, severity="soft")
        assert behaviour_of(case, verdict, {}, signals) == "p, soft, in mode -1"


def test_a_signal_that_shows_how_a_failsafe_is_set_is_none_that_is_raised() -> None:
    mode = [(0.0, MODES[LOITER]), (5.0, MODES[RTL])]
    shown = [(0.0, 1.5)]
    found = steps([], mode=mode, failsafe_delay_set_s=shown, failsafe_procedure=shown, failsafe_options_set=shown)
    assert found == [Transition(LOITER, RTL, -1, -1)]
