"""Excuses: which stimuli end which flags, for how long; and policies whose inputs would silence them for good."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.errors import Refused
from saflite.contract.test_case import Stimulus, StimulusKind
from saflite.oracle.effects import FLAGS, LEARNT_S, SETTLE_S, STRONG_TIMES, effect_of, silencing, undisturbed
from saflite.oracle.policy import POLICIES_DIR, parse_policy, policy_names

TIMES = np.arange(0.0, 300.0, 0.5)


def given(kind: StimulusKind, name: str, *values: float, at_s: float = 10.0) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)


def down(flag: str, *stimuli: Stimulus, before: dict[str, float] | None = None) -> list[float]:
    """Return the times at which the flag is 0."""
    return [float(at_s) for at_s in TIMES[undisturbed(flag, stimuli, before or {}, TIMES) == 0]]


@pytest.mark.parametrize(
    ("kind", "name", "value", "flags"),
    [
        ("sensor_fault", "SIM_GPS_NOISE", 5.0, {"gps_true", "gps_settled"}),
        ("sensor_fault", "gps_loss", 1.0, {"gps_true", "gps_settled"}),
        ("parameter", "SIM_GPS_GLITCH_X", 50.0, {"gps_true", "gps_settled"}),
        ("sensor_fault", "SIM_GPS_GLITCH_Z", 50.0, {"gps_true"}),
        ("sensor_fault", "SIM_BARO_DRIFT", 1.0, {"baro_true", "baro_settled"}),
        ("sensor_fault", "baro_offset", 10.0, {"baro_true", "baro_settled"}),
        ("parameter", "GND_ALT_OFFSET", 10.0, {"baro_true", "baro_settled"}),
        ("parameter", "GND_TEMP", 60.0, {"baro_true", "baro_settled"}),  # heights are reckoned with other air
        ("parameter", "AHRS_TRIM_X", 0.1, {"body_true"}),
        ("parameter", "INS_GYROFFS_X", 0.02, {"body_true"}),
        ("parameter", "INS_GYROFFS_X", 0.005, set()),
        ("parameter", "ATC_RATE_R_MAX", 5.0, {"body_true"}),
        ("parameter", "ATC_RATE_P_MAX", 60.0, set()),
        ("sensor_fault", "SIM_ENGINE_FAIL", 2.0, set()),
        ("sensor_fault", "SIM_ENGINE_MUL", 0.5, {"body_true"}),
        ("sensor_fault", "SIM_ENGINE_MUL", 1.0, set()),
        ("sensor_fault", "SIM_GYR_RND", 5.0, {"body_true"}),
        ("sensor_fault", "SIM_RC_FAIL", 1.0, set()),
        ("sensor_fault", "radio_loss", 1.0, set()),
        ("sensor_fault", "SIM_BATT_VOLTAGE", 9.0, set()),
        ("parameter", "RC3_MIN", 1100.0, {"sticks_true", "ends_true"}),
        ("parameter", "THR_DZ", 250.0, {"sticks_true"}),  # a full stick stays full
        ("parameter", "RC1_MIN", 1100.0, set()),
        ("parameter", "RC1_TRIM", 1500.0, set()),
        ("parameter", "TUNE", 39.0, {"sticks_true", "ends_true"}),  # channel 6 decides the rate of CIRCLE
        ("parameter", "TUNE", 0.0, set()),
        ("parameter", "RTL_ALT", 3000.0, set()),
        ("command", "MAV_CMD_SET_EKF_SOURCE_SET", 2.0, set(FLAGS) - {"sticks_true", "ends_true"}),
        ("command", "MAV_CMD_SET_EKF_SOURCE_SET", 1.0, set()),
        ("command", "MAV_CMD_FIXED_MAG_CAL_YAW", 301.0, {"body_true"}),
        ("command", "MAV_CMD_FIXED_MAG_CAL_YAW", 0.0, {"body_true"}),
        ("command", "MAV_CMD_DO_SET_HOME", 1.0, set()),
        ("stick", "RC3", 1500.0, set()),
        ("mode", "LOITER", 0.0, set()),
    ],
)
def test_only_what_can_cause_an_effect_excuses(kind: StimulusKind, name: str, value: float, flags: set[str]) -> None:
    assert {flag for flag in FLAGS if down(flag, given(kind, name, value))} == flags


def test_a_passing_effect_is_over_when_the_estimate_has_followed() -> None:
    times = down("baro_settled", given("sensor_fault", "SIM_BARO_GLITCH", 30.0))
    assert (times[0], times[-1]) == (10.0, 10.0 + SETTLE_S + 30.0 - 0.5), "a second for each metre to be flown off"
    assert down("baro_true", given("sensor_fault", "SIM_BARO_GLITCH", 30.0))[-1] == TIMES[-1], "it still tells a lie"
    gps = down("gps_settled", given("sensor_fault", "SIM_GPS_GLITCH_X", 80.0))
    assert (gps[0], gps[-1]) == (10.0, 10.0 + SETTLE_S - 0.5)


def test_a_lasting_effect_is_over_when_it_was_taken_back_and_recovered_from() -> None:
    noise = given("sensor_fault", "SIM_BARO_RND", 3.0)
    assert down("baro_settled", noise)[-1] == TIMES[-1]
    times = down("baro_settled", noise, given("sensor_fault", "SIM_BARO_RND", 0.0, at_s=40.0))
    assert (times[0], times[-1]) == (10.0, 40.0 + SETTLE_S - 0.5)
    assert down("gps_settled", given("sensor_fault", "SIM_GPS_NOISE", 0.0)) == [], "it was off and stays off"


@pytest.mark.parametrize(("field", "times"), [(200.0, 1.0), (500.0, STRONG_TIMES)])
def test_a_strong_false_sensor_is_unlearnt_slowly(field: float, times: float) -> None:
    fault = given("sensor_fault", "SIM_MAG_OFFSET_Y", field), given("sensor_fault", "SIM_MAG_OFFSET_Y", 0.0, at_s=15.0)
    flag = undisturbed("body_true", fault, {}, TIMES, {"SIM_MAG_OFFSET_Y": (-500.0, 500.0)})
    assert TIMES[flag == 0][-1] == 15.0 + SETTLE_S + 5.0 * times - 0.5, "5 s of it"


def test_a_drift_that_has_stopped_leaves_its_offset() -> None:
    drift = given("sensor_fault", "SIM_BARO_DRIFT", -4.0), given("sensor_fault", "SIM_BARO_DRIFT", 0.0, at_s=20.0)
    assert down("baro_true", *drift)[-1] == TIMES[-1]
    assert down("baro_settled", *drift)[-1] == 20.0 + SETTLE_S - 0.5, "the estimate follows it all the same"


def test_what_was_set_before_the_start_is_in_force_from_the_start() -> None:
    assert down("baro_settled", before={"SIM_BARO_RND": 2.0}) == TIMES.tolist()
    assert down("baro_settled", before={"SIM_BARO_GLITCH": 2.0}) == [], "settled long before"


def test_a_breeze_excuses_for_a_moment_and_a_storm_while_it_blows() -> None:
    assert down("body_true", given("sensor_fault", "SIM_WIND_SPD", 5.0))[-1] < 40.0
    assert down("body_true", given("sensor_fault", "SIM_WIND_SPD", 14.0))[-1] == TIMES[-1]


def test_no_policy_lists_an_input_that_silences_it() -> None:
    """Loading refuses it (below); what still is in force for good is told here."""
    assert silencing("sensor_fault", "SIM_BARO_RND") == ("baro_true", "baro_settled")
    assert silencing("sensor_fault", "SIM_WIND_SPD") == ()
    assert effect_of(given("sensor_fault", "SIM_GPS_DISABLE", 1.0)).lasting == ()
    assert len(policy_names()) > 60


@pytest.mark.parametrize(("name", "fault"), [("a-brake1", "SIM_GPS_NOISE"), ("a-land1", "SIM_BARO_DRIFT")])
def test_a_policy_whose_inputs_silence_it_is_refused_with_the_input_named(name: str, fault: str) -> None:
    text = (POLICIES_DIR / f"{name}.toml").read_text(encoding="utf-8")
    parse_policy(text, "mine.toml")
    with pytest.raises(Refused, match=f"(?s)inputs.*{fault}.*never speaks"):
        parse_policy(text.replace("sensor_faults = [", f'sensor_faults = ["{fault}", '), "mine.toml")


def test_a_setting_out_of_its_documented_range_excuses_nothing() -> None:
    offset, ranges = given("parameter", "GND_ALT_OFFSET", 300.0), {"GND_ALT_OFFSET": (-10.0, 10.0)}
    assert undisturbed("baro_settled", [offset], {}, TIMES).min() == 0.0, "nothing is known of its range"
    assert undisturbed("baro_settled", [offset], {}, TIMES, ranges).min() == 1.0


def test_a_bias_the_estimator_learnt_is_unlearnt_in_the_same_time() -> None:
    def recovered_s(held_s: float) -> float:
        faults = (
            given("sensor_fault", "SIM_GYR_BIAS_X", 0.05),
            given("sensor_fault", "SIM_GYR_BIAS_X", 0.0, at_s=10.0 + held_s),
        )
        return down("body_true", *faults)[-1] + 0.5 - 10.0 - held_s

    assert recovered_s(10.0) == SETTLE_S + 10.0
    assert recovered_s(100.0) == SETTLE_S + LEARNT_S, "the excuse ends"
