"""Signals the oracle makes itself: from the test case, the ending, and the rest of the trace."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, DeliveryAnswer, Ending, Flight, Given, Trace, TraceMessage
from saflite.contract.signals import SIGNALS
from saflite.contract.test_case import Scenario, Stimulus, StimulusKind, Target, TestCase
from saflite.flight.autopilots.reference.parameter_types import TYPES
from saflite.flight.autopilots.reference.parameters import parameter_table
from saflite.oracle.headings import headings
from saflite.oracle.log_text import describe, facts_of, rule_of_thumb
from saflite.oracle.orders import SETTINGS, forces_arming, may_change_mode, mode_ordered, stops_motors
from saflite.oracle.signals import FlightSignals

STEP_S = 0.5


def signals(
    *stimuli: Stimulus,
    ending: Ending = "completed",
    delivered: tuple[Delivered, ...] | None = None,
    **written: list[float],
) -> FlightSignals:
    columns = {name: np.asarray(values, dtype="<f4").tobytes() for name, values in written.items()}
    case = TestCase(target=Target(), scenario=Scenario(), stimuli=stimuli)
    flight = Flight(test_case="", flight_index=0, ending=ending, delivered=delivered)
    return FlightSignals(case, flight, Trace(step_s=STEP_S, signals=columns))


def stimulus(kind: StimulusKind, name: str, *values: float, at_s: float = 1.0) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)


@pytest.mark.parametrize(
    ("name", "values", "stops"),
    [
        ("MAV_CMD_DO_FLIGHTTERMINATION", (1.0,), True),
        ("MAV_CMD_DO_FLIGHTTERMINATION", (0.0,), False),
        ("MAV_CMD_COMPONENT_ARM_DISARM", (0.0, 21196.0), True),
        ("MAV_CMD_COMPONENT_ARM_DISARM", (0.0, 0.0), False),
        ("MAV_CMD_COMPONENT_ARM_DISARM", (1.0, 21196.0), False),
        ("MAV_CMD_NAV_LAND", (), False),
        ("MAV_CMD_DO_AUX_FUNCTION", (81.0, 2.0), True),  # disarm
        ("MAV_CMD_DO_AUX_FUNCTION", (81.0, 0.0), False),
        ("MAV_CMD_DO_AUX_FUNCTION", (153.0, 0.0), True),  # arm or disarm
        ("MAV_CMD_DO_AUX_FUNCTION", (153.0, 2.0), False),
        ("MAV_CMD_DO_AUX_FUNCTION", (154.0, 0.0), True),  # the same with air mode
        ("MAV_CMD_DO_AUX_FUNCTION", (165.0, 0.0), True),  # arm or emergency stop
        ("MAV_CMD_DO_AUX_FUNCTION", (165.0,), True),
        ("MAV_CMD_DO_AUX_FUNCTION", (165.0, 2.0), False),
        ("MAV_CMD_DO_AUX_FUNCTION", (31.9, 2.9), True),  # emergency stop: ArduPilot cuts fractions off
        ("MAV_CMD_DO_AUX_FUNCTION", (31.0, 0.0), False),
        ("MAV_CMD_DO_AUX_FUNCTION", (32.0, 0.0), True),  # interlock
        ("MAV_CMD_DO_AUX_FUNCTION", (9.0, 2.0), False),
    ],
)
def test_only_forced_stops_excuse_motors_off(name: str, values: tuple[float, ...], stops: bool) -> None:
    assert stops_motors(stimulus("command", name, *values)) is stops


@pytest.mark.parametrize(
    ("values", "obeys"),
    [((31.0, 2.0), 0.0), ((165.0, 0.0), 0.0), ((32.0, 0.0), 0.0), ((31.0, 0.0), 1.0), ((81.0, 2.0), 1.0)],
)
def test_motors_that_were_ordered_to_stand_hold_nothing(values: tuple[float, ...], obeys: float) -> None:
    """By these switches the vehicle stays armed; one that is disarmed is none of the rules' that ask what it holds."""
    told = signals(stimulus("command", "MAV_CMD_DO_AUX_FUNCTION", *values, at_s=1.0), x_m=[0.0] * 6)
    assert told["body_true"].tolist()[0] == 1.0
    assert told["body_true"].tolist()[-1] == obeys


def test_quiet_times_and_flags_follow_the_stimuli() -> None:
    given = signals(
        stimulus("parameter", "RTL_ALT", 1.0, at_s=0.5),
        stimulus("mode", "RTL", at_s=1.0),
        stimulus("sensor_fault", "SIM_BARO_RND", 1.0, at_s=1.5),
        x_m=[0.0] * 6,
    )
    assert given["time_s"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert given["quiet_s"].tolist() == [0.0, 0.0, 0.0, 0.0, 0.5, 1.0]
    assert given["order_quiet_s"].tolist() == [0.0, 0.5, 0.0, 0.5, 1.0, 1.5]
    assert given["calm_s"].tolist() == [0.0, 0.5, 0.0, 0.0, 0.5, 1.0], "RTL_ALT moves nothing by itself"
    assert given["baro_true"].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    assert given["gps_true"].min() == 1.0


REPOSITION = stimulus("command", "MAV_CMD_DO_REPOSITION", -1, 1, 0, 0, 47.4, 8.55, 25.0, at_s=0.5)
TURN = stimulus("command", "MAV_CMD_CONDITION_YAW", 90.0, at_s=0.5)
CAUSES = {
    "quiet_s": stimulus("parameter", "RTL_ALT", 1.0, at_s=0.5),
    "order_quiet_s": stimulus("stick", "RC3", 1500.0, at_s=0.5),
    "command_quiet_s": stimulus("command", "MAV_CMD_NAV_LAND", at_s=0.5),
    "divert_order_s": stimulus("command", "MAV_CMD_NAV_LAND", at_s=0.5),
    "mode_cause_s": stimulus("mode", "RTL", at_s=0.5),
    "calm_s": stimulus("parameter", "PSC_POSXY_P", 1.0, at_s=0.5),
    "home_quiet_s": stimulus("command", "MAV_CMD_DO_SET_HOME", 1.0, at_s=0.5),
    "gps_true": stimulus("sensor_fault", "SIM_GPS_DISABLE", 1.0, at_s=0.5),
    "gps_settled": stimulus("sensor_fault", "SIM_GPS_GLITCH_X", 9.0, at_s=0.5),
    "baro_true": stimulus("sensor_fault", "SIM_BARO_RND", 1.0, at_s=0.5),
    "baro_settled": stimulus("parameter", "GND_ALT_OFFSET", 5.0, at_s=0.5),
    "sticks_true": stimulus("parameter", "RC3_MIN", 1100.0, at_s=0.5),
    "ends_true": stimulus("parameter", "RC3_MIN", 1100.0, at_s=0.5),
    "body_true": stimulus("sensor_fault", "SIM_ENGINE_MUL", 0.5, at_s=0.5),
    "stop_ordered": stimulus("command", "MAV_CMD_COMPONENT_ARM_DISARM", 0.0, 21196.0, at_s=0.5),
    "arming_forced": stimulus("command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, 21196.0, at_s=0.5),
    **dict.fromkeys(("place_order_s", "ordered_x_m", "ordered_y_m", "ordered_altitude_m"), REPOSITION),
    "pause_order_s": stimulus("command", "MAV_CMD_DO_PAUSE_CONTINUE", 0.0, at_s=0.5),
    **dict.fromkeys(("yaw_order_s", "ordered_yaw_deg"), TURN),
    **{
        name: stimulus("parameter", row.parameter, row.high if row.high < 1e5 else 7.0, at_s=0.5)
        for name, row in SETTINGS.items()
        if name not in ("fence_type_set",)
    },
    **{f"rc{channel}_sent_pwm": stimulus("stick", f"RC{channel}", 1700.0, at_s=0.5) for channel in (1, 2, 3, 4)},
    "gps_noise_set_m": stimulus("sensor_fault", "SIM_GPS_NOISE", 2.0, at_s=0.5),
    "hover_throttle_set": stimulus("parameter", "MOT_THST_HOVER", 0.3, at_s=0.5),
    "pitch_rate_max_set_dps": stimulus("parameter", "ATC_RATE_P_MAX", 100.0, at_s=0.5),
    "pitch_acceleration_set_dps2": stimulus("parameter", "ATC_ACCEL_P_MAX", 900.0, at_s=0.5),
    "acro_trainer_set": stimulus("parameter", "ACRO_TRAINER", 0.0, at_s=0.5),
    "chute_type_set": stimulus("parameter", "CHUTE_TYPE", 1.0, at_s=0.5),
    "chute_present_set": stimulus("parameter", "SIM_PARA_ENABLE", 0.0, at_s=0.5),
    "climb_order_s": stimulus("command", "MAV_CMD_DO_CHANGE_SPEED", 2.0, 8.0, at_s=0.5),
    "height_order_s": stimulus("command", "MAV_CMD_DO_CHANGE_ALTITUDE", 8.0, at_s=0.5),
    "start_order_s": stimulus("command", "MAV_CMD_MISSION_START", at_s=0.5),
    "ordered_home_m": stimulus("command", "MAV_CMD_DO_SET_HOME", 0, 0, 0, 0, 47.4, 8.55, at_s=0.5),
    "arming_checks_set": stimulus("parameter", "ARMING_CHECK", 0.0, at_s=0.5),
    "fence_type_set": stimulus("parameter", "FENCE_TYPE", 1.0, at_s=0.5),
}
ASKED = {
    **dict.fromkeys(("mode_order_s", "ordered_mode"), stimulus("mode", "LAND", at_s=0.5)),
    **dict.fromkeys(
        ("plain_order", "plain_order_s"), stimulus("command", "MAV_CMD_NAV_TAKEOFF", *[0.0] * 6, 9.0, at_s=0.5)
    ),
    "release_order_s": stimulus("command", "MAV_CMD_DO_PARACHUTE", 2.0, at_s=0.5),
    "stop_order_s": stimulus("command", "MAV_CMD_DO_FLIGHTTERMINATION", 1.0, at_s=0.5),
}
"""What was asked for counts, whether it was denied or not."""
ROWS: dict[str, Any] = {
    "x_m": [0.0] * 6,
    "y_m": [0.0] * 6,
    "armed": [0.0] * 6,
    "yaw_deg": [10.0] * 6,
    "pilot_speed_up_set_mps": [2.5] * 6,
}


@pytest.mark.parametrize("name", CAUSES)
def test_what_was_delivered_counts_and_not_the_plan(name: str) -> None:
    def seen(*delivered: Delivered) -> list[float]:
        made: list[float] = signals(CAUSES[name], delivered=delivered, **ROWS)[name].tolist()
        return made

    planned = signals(CAUSES[name], **ROWS)[name].tolist()
    idle = signals(**ROWS)[name].tolist()
    later = signals(msgspec.structs.replace(CAUSES[name], at_s=1.5), **ROWS)[name].tolist()
    assert len({tuple(planned), tuple(idle), tuple(later)}) == 3, "the signal depends on the stimulus"
    assert seen(Delivered(index=0, at_s=0.5)) == planned
    assert seen(Delivered(index=0, at_s=0.5, answer="unanswered")) == planned
    assert seen(Delivered(index=0, at_s=1.5, answer="late")) == later
    answers: tuple[DeliveryAnswer, ...] = ("denied", "timed_out")
    for answer in answers:
        assert seen(Delivered(index=0, at_s=0.5, answer=answer)) == idle, answer
    assert seen() == idle, "never given: the flight ended before"


@pytest.mark.parametrize("name", ASKED)
def test_what_was_asked_for_counts_though_it_was_denied(name: str) -> None:
    def seen(*delivered: Delivered) -> list[float]:
        return list(signals(ASKED[name], delivered=delivered, **ROWS)[name])

    planned, idle = list(signals(ASKED[name], **ROWS)[name]), list(signals(**ROWS)[name])
    assert planned != idle
    assert seen(Delivered(index=0, at_s=0.5)) == planned == seen(Delivered(index=0, at_s=0.5, answer="denied"))
    assert seen(Delivered(index=0, at_s=0.5, answer="timed_out")) == idle == seen()


@pytest.mark.parametrize(
    ("order", "mode"),
    [
        (stimulus("mode", "brake"), 17),
        (stimulus("mode", "nowhere"), None),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 1.0, 6.0), 6),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 0.0, 6.0), None),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 1.0, 400.0), None),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", float("nan"), 6.0), None),
        (stimulus("command", "MAV_CMD_NAV_RETURN_TO_LAUNCH"), 6),
        (stimulus("command", "MAV_CMD_SOLO_BTN_PAUSE_CLICK"), 17),
        (stimulus("command", "MAV_CMD_DO_SEND_BANNER"), None),
    ],
)
def test_which_mode_an_order_asks_for(order: Stimulus, mode: int | None) -> None:
    assert mode_ordered(order) == mode


@pytest.mark.parametrize(
    ("order", "may"),
    [
        (stimulus("mode", "RTL"), True),
        (stimulus("stick", "RC5", 1500.0), True),
        (stimulus("command", "MAV_CMD_NAV_LAND"), True),
        (stimulus("command", "MAV_CMD_DO_REPOSITION", 0.0, 1.0), True),
        (stimulus("command", "MAV_CMD_DO_REPOSITION", 0.0, float("nan")), True),
        (stimulus("command", "MAV_CMD_DO_REPOSITION", 0.0, 0.0), False),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 1.0, 9.0), True),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 1.0, 16.0), True),  # POSHOLD, which the reference does not have
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 1.0, float("nan")), True),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 1.0, 8.0), False),
        (stimulus("command", "MAV_CMD_DO_SET_MODE", 1.0, 77.0), False),
        (stimulus("command", "MAV_CMD_DO_SET_HOME"), False),
        (stimulus("command", "MAV_CMD_CONDITION_YAW"), False),
        (stimulus("parameter", "RTL_ALT", 1.0), False),
        (stimulus("sensor_fault", "SIM_GPS_DISABLE", 1.0), False),
    ],
)
def test_what_may_change_the_mode(order: Stimulus, *, may: bool) -> None:
    assert may_change_mode(order) is may


def test_what_starts_motors_without_checks() -> None:
    assert forces_arming(stimulus("command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, 21196.0))
    assert not forces_arming(stimulus("command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, 0.0))
    assert forces_arming(stimulus("command", "MAV_CMD_DO_MOTOR_TEST", 3.0, 25.0, 71.0, 95.0, 7.0, 31.0, 29.0))
    assert forces_arming(stimulus("command", "MAV_CMD_PREFLIGHT_CALIBRATION", 1.0, 0.0, 0.0, 0.0, 1.0, 1.0))
    assert not forces_arming(stimulus("command", "MAV_CMD_PREFLIGHT_CALIBRATION", 1.0, 0.0, 0.0, 0.0, 1.0, 0.0))


def test_a_place_to_look_at_is_a_heading_from_where_the_vehicle_is_unless_it_is_near() -> None:
    times, here = np.arange(6.0), np.zeros(6, dtype=np.float32)
    east = stimulus("command", "MAV_CMD_DO_SET_ROI", 0, 0, 0, 0, 47.3977419, 8.5465938)
    below = stimulus("command", "MAV_CMD_DO_SET_ROI", 0, 0, 0, 0, 47.3977419, 8.5456038)
    case = TestCase(target=Target(), scenario=Scenario())
    ((at_s, heading_deg, way),) = headings(
        case, [Given(east, "accepted"), Given(below, "accepted")], (here, here, here), times
    )
    assert (at_s, round(heading_deg), way) == (1.0, 90, 0)
    other = TestCase(target=Target(name="px4"), scenario=Scenario())
    assert headings(other, [Given(east, "accepted")], (here, here, here), times) == []


def test_an_order_to_turn_slowly_is_none_of_those_that_are_soon_reached() -> None:
    yaw, times = np.zeros(11, dtype=np.float32), np.arange(11.0)
    slow = stimulus("command", "MAV_CMD_CONDITION_YAW", 90.0, 1.0, at_s=1.0)
    fast = stimulus("command", "MAV_CMD_CONDITION_YAW", 40.0, 30.0, at_s=2.0)
    given = [Given(slow, "accepted"), Given(TURN, "accepted"), Given(fast, "accepted")]
    assert headings(TestCase(target=Target(), scenario=Scenario()), given, (yaw, yaw, yaw), times) == [
        (0.5, 90.0, 0),
        (2.0, 40.0, 0),
    ]


@pytest.mark.parametrize(
    ("numbers", "heading_deg", "way"),
    [
        ((350.0, 30.0, 1.0, 0.0), 350.0, 1),
        ((350.0, 30.0, -1.0, 0.0), 350.0, -1),
        ((350.0, 30.0, 0.0, 0.0), 350.0, 0),
        ((270.0, 30.0, 1.0, 1.0), 280.0, 1),
        ((270.0, 30.0, -1.0, 1.0), 100.0, -1),
        ((270.0, 30.0, 0.0, 1.0), 280.0, 1),
    ],
)
def test_an_order_to_turn_says_the_way_round(numbers: tuple[float, ...], heading_deg: float, way: int) -> None:
    yaw, times = np.full(6, 10.0, dtype=np.float32), np.arange(6.0)
    given = [Given(stimulus("command", "MAV_CMD_CONDITION_YAW", *numbers), "accepted")]
    case = TestCase(target=Target(name="ardupilot"), scenario=Scenario())
    assert headings(case, given, (yaw, yaw, yaw), times) == [(1.0, heading_deg, way)]


def test_a_signal_made_of_the_plan_does_not_escape_the_test_above() -> None:
    """Every signal that moves with the stimuli is among the causes."""
    busy = signals(*CAUSES.values(), *ASKED.values(), **ROWS)
    idle = signals(**ROWS)
    made = [name for name in SIGNALS if name in idle and name not in ("obstacle_distance_m",)]
    assert {name for name in made if busy[name].tolist() != idle[name].tolist()} == {*CAUSES, *ASKED}


def test_settings_that_an_autopilot_keeps_as_whole_numbers_are_read_as_it_keeps_them() -> None:
    """DISARM_DELAY 0.17 is 0, which means never."""
    known = parameter_table()
    assert [
        name for name, row in SETTINGS.items() if row.whole != (row.parameter in TYPES) and row.parameter in known
    ] == []


def test_an_accepted_value_out_of_range_is_in_force_a_planned_one_is_held_to_be_refused() -> None:
    timer = stimulus("parameter", "BATT_LOW_TIMER", 500.0, at_s=0.5)
    taken = signals(timer, delivered=(Delivered(index=0, at_s=0.5),), x_m=[0.0] * 3)
    assert taken["battery_timer_set_s"].tolist() == [5.0, 500.0, 500.0]
    assert signals(timer, x_m=[0.0] * 3)["battery_timer_set_s"].tolist() == [5.0] * 3, (
        "the target's own default, not the manual's"
    )


def test_a_fence_switched_by_command_is_switched() -> None:
    plan = (
        stimulus("parameter", "FENCE_ENABLE", 1.0, at_s=0.5),
        stimulus("command", "MAV_CMD_DO_FENCE_ENABLE", 0.0, 79.0, at_s=1.0),
        stimulus("command", "MAV_CMD_DO_FENCE_ENABLE", 2.0, at_s=1.5),
        stimulus("command", "MAV_CMD_DO_FENCE_ENABLE", 1.0, at_s=2.0),
    )
    given = tuple(Delivered(index=index, at_s=one.at_s) for index, one in enumerate(plan))
    assert signals(*plan, delivered=given, x_m=[0.0] * 5)["fence_on_set"].tolist() == [0.0, 1.0, 0.0, 0.0, 1.0]
    denied = (given[0], msgspec.structs.replace(given[1], answer="denied"))
    assert signals(*plan, delivered=denied, x_m=[0.0] * 5)["fence_on_set"].tolist() == [0.0, 1.0, 1.0, 1.0, 1.0]


def test_stimuli_count_in_the_order_given_and_a_stranger_is_refused() -> None:
    plan = (stimulus("parameter", "BATT_LOW_TIMER", 20.0, at_s=0.5), stimulus("parameter", "BATT_LOW_TIMER", 30.0))
    turned = (Delivered(index=1, at_s=0.5), Delivered(index=0, at_s=1.0, answer="late"))
    assert signals(*plan, delivered=turned, x_m=[0.0] * 3)["battery_timer_set_s"].tolist() == [5.0, 30.0, 20.0]
    with pytest.raises(Refused, match="delivered"):
        signals(*plan, delivered=(Delivered(index=2, at_s=0.5),), x_m=[0.0])


def test_only_a_crash_raises_crashed() -> None:
    assert signals(ending="crashed", x_m=[0.0] * 3)["crashed"].tolist() == [0.0, 0.0, 1.0]
    assert signals(ending="timed_out", x_m=[0.0] * 3)["crashed"].tolist() == [0.0, 0.0, 0.0]


def test_made_signals_need_their_sources() -> None:
    given = signals(vx_mps=[3.0], vy_mps=[4.0], roll_deg=[60.0], altitude_m=[7.0])
    assert given["ground_speed_mps"].tolist() == [5.0]
    assert given["altitude_est_m"].tolist() == [7.0]
    assert "tilt_deg" not in given
    assert "home_distance_m" not in given
    assert set(given.pick(frozenset({"tilt_deg", "ground_speed_mps"}))) == {"ground_speed_mps"}


def test_a_log_is_told_as_text_and_as_facts() -> None:
    samples = 100
    columns = {
        "altitude_m": np.linspace(0, 20, samples),
        "mode": [4.0] * 50 + [9.0] * 50,
        "climb_mps": [-6.0] * samples,
    }
    trace = Trace(
        step_s=0.1,
        signals={name: np.asarray(values, dtype="<f4").tobytes() for name, values in columns.items()},
        messages=(TraceMessage(at_s=5.0, text="EKF failsafe: position lost", severity="error"),),
    )
    text, facts = describe(trace), facts_of(trace)
    for part in ("Duration 9.9 s", "0.0 s GUIDED", "5.0 s LAND", "error: EKF failsafe", "0.00, 10.00, 20.00 m"):
        assert part in text
    assert (facts.errors, facts.failsafes, facts.mode_changes, facts.sink_max_mps) == (1, 1, 1, 6.0)
    assert tuple(rule_of_thumb(facts)) == (pytest.approx(2.5 + 2.5 + 1.5), "1 errors, 1 failsafes, sinks 6.0 m/s")
    quiet = Trace(step_s=0.1, signals={"altitude_m": np.zeros(50, dtype="<f4").tobytes()})
    assert rule_of_thumb(facts_of(quiet)) == (0.0, "nothing out of the ordinary")
    empty = Trace(step_s=0.1, signals=dict.fromkeys((*columns, "altitude_target_m", "altitude_est_m", "tilt_deg"), b""))
    assert describe(empty).startswith("Duration 0.0 s")
    assert rule_of_thumb(facts_of(empty)).score == 0.0


@pytest.mark.parametrize(("distance_m", "told", "score"), [(1.2, True, 6.0), (3.0, True, 0.0), (1000.0, False, 0.0)])
def test_a_near_miss_is_told_and_counts(distance_m: float, told: bool, score: float) -> None:
    columns = {"x_m": [0.0, 1.0, 2.0], "obstacle_distance_m": [1000.0, distance_m, 1000.0]}
    packed = {name: np.asarray(values, dtype="<f4").tobytes() for name, values in columns.items()}
    trace = Trace(step_s=0.1, signals=packed)
    assert ("competition distance" in describe(trace)) == told
    assert rule_of_thumb(facts_of(trace)).score == score


def test_an_antenna_moved_back_may_be_where_it_was_until_the_next_start() -> None:
    moved = stimulus("parameter", "GPS_POS1_X", -3.0, at_s=0.5), stimulus("parameter", "GPS_POS1_X", 0.0, at_s=1.5)
    assert signals(*moved, **ROWS)["gps_forward_set_m"].tolist() == [0.0, 3.0, 3.0, 3.0, 3.0, 3.0]


def test_who_may_not_lean_against_its_trim_is_not_sound() -> None:
    narrow = stimulus("parameter", "ANGLE_MAX", 1000.0, at_s=0.0)
    askew = stimulus("parameter", "AHRS_TRIM_X", 0.16, at_s=0.0)
    assert signals(narrow, **ROWS)["body_true"].all()
    assert not signals(narrow, askew, **ROWS)["body_true"][1:].any()


def test_a_speed_ordered_counts_where_a_target_writes_the_setting() -> None:
    ordered = stimulus("command", "MAV_CMD_DO_CHANGE_SPEED", 1.0, 8.0, at_s=0.5)
    assert signals(ordered, cruise_speed_set_mps=[5.0] * 6)["cruise_speed_set_mps"].tolist() == [5, 8, 8, 8, 8, 8]
