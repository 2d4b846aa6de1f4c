"""What the text of a rule tells a search: modes, failsafes, quiet, settings."""

from __future__ import annotations

from saflite.campaign.presets.formula_hints import (
    QUIET_MAX_S,
    antecedents,
    failsafes_named,
    far_asked_m,
    faults_asked,
    modes_named,
    quiet_asked_s,
    sensor_lost,
    settings_asked,
    settings_pushed,
    sticks_held,
    whole_formula,
)
from saflite.flight.autopilots.reference.describe import describe

RULE = {
    "formula": "always (lasting[25] (under_way and calm_s >= 5) implies eventually[0:2] (mode == LAND))",
    "terms": {"under_way": "mode == RTL and failsafe_gps == 1 and fence_action_set >= least and home_distance_m <= 2"},
    "constants": {"least": 4.0},
}


def test_named_parts_and_constants_are_written_out() -> None:
    formula = whole_formula(RULE)
    assert modes_named(formula) == ("LAND", "RTL")
    assert failsafes_named(formula) == ("gps",)
    assert quiet_asked_s(formula) == 25 + 5 + 2
    asked = settings_asked(formula, describe())
    assert [(entry.name, value) for entry, value in asked] == [("FENCE_ACTION", 4.0)]


def test_a_size_that_a_setting_does_not_have_by_default_is_asked_for_in_its_unit() -> None:
    asked = settings_asked("always (rtl_altitude_final_set_m >= 4 implies land_speed_set_mps <= 0.2)", describe())
    assert [(entry.name, value) for entry, value in asked] == [("RTL_ALT_FINAL", 800.0)]
    assert settings_asked("always (rtl_altitude_final_set_m >= 900 implies landed == 1)", describe()) == ()


def test_sizes_that_settings_have_and_defaults_are_asked_of_no_setting() -> None:
    assert settings_asked("always (rtl_altitude_set_m >= 15 implies battery_low_action_set >= 2)", describe()) == ()
    assert quiet_asked_s("always (altitude_m >= 0)") == 0.0
    assert quiet_asked_s("always (lasting[500] (altitude_m >= 0) implies landed == 1)") == QUIET_MAX_S


def test_a_time_among_the_constants_is_waited_for() -> None:
    formula = "always (gps_ok == 0 implies failsafe_gps == 1)"
    assert quiet_asked_s(formula, {"grace_s": 12.0, "least_m": 30.0, "forever_s": 1e6}) == 13.0
    assert quiet_asked_s("always (lasting[20] (landed == 1) implies armed == 0)", {"grace_s": 12.0}) == 20.0
    assert quiet_asked_s(formula, {"odd_s": "soon"}) == 0.0


def test_sticks_are_held_where_a_formula_asks_for_them_off_the_middle() -> None:
    formula = (
        "lasting[3] (rc3_pwm >= 1950 or rc3_pwm <= 1050) and rc1_pwm >= 1500 and rc2_pwm <= 1900 and rc4_pwm < limit"
    )
    held = [(entry.name, value) for entry, value in sticks_held(formula, describe())]
    assert held == [("RC3", 2000.0), ("RC3", 1000.0)]


def test_a_stick_compared_with_a_setting_is_held_beside_its_default() -> None:
    held = sticks_held("lasting[2] (rc3_pwm < fs_throttle_set_pwm) implies armed == 0", describe())
    assert [(entry.name, value) for entry, value in held] == [("RC3", 950.0)]
    assert sticks_held("rc3_pwm < rc2_pwm and rc1_pwm > no_such_signal", describe()) == ()


def test_a_rule_with_odd_parts_tells_what_it_can() -> None:
    assert whole_formula({"formula": 3, "terms": "none", "constants": []}) == "3"


def test_what_a_rule_asks_for_is_told_from_what_it_promises() -> None:
    rule = {
        "formula": "always (lasting[2] away implies mode == LAND)",
        "terms": {"away": "flying and home_distance_m >= far_m + 5", "flying": "mode == GUIDED"},
        "constants": {"far_m": 10.0},
    }
    asked = antecedents(rule)
    assert modes_named(asked) == ("GUIDED",)
    assert far_asked_m(asked, describe()) == 15.0
    assert far_asked_m("home_distance_m >= fence_radius_set_m + 5", describe()) == 30.0
    assert far_asked_m("home_distance_m <= 5", describe()) == 0.0
    assert antecedents({"formula": "always (tilt_deg <= 60)"}) == "always (tilt_deg <= 60)"
    assert antecedents({"formula": 3, "terms": "none", "constants": []}) == "3"
    endless = {"formula": "always (a implies b)", "terms": {"a": "(a or a)"}}
    assert antecedents(endless)


def test_sums_of_a_stick_s_middle_are_worked_out() -> None:
    rule = {"formula": "rc1_pwm <= 1500 - off and rc2_pwm >= 1500 + off", "constants": {"off": 100.0}}
    held = [(entry.name, value) for entry, value in sticks_held(whole_formula(rule), describe())]
    assert held == [("RC1", 1000.0), ("RC2", 2000.0)]
    product = {"formula": "altitude_m >= 2 + 3 * off", "constants": {"off": 100.0}}
    assert "2 + 3 * 100.0" in whole_formula(product)


def test_a_setting_beside_a_state_is_pushed_the_way_that_makes_it_true() -> None:
    asked = "altitude_est_m >= fence_altitude_max_set_m + 2 and altitude_est_m < latch(rtl_altitude_set_m, mode == RTL)"
    pushed = [(entry.name, sense) for entry, sense in settings_pushed(asked, describe())]
    assert pushed == [("FENCE_ALT_MAX", -1.0), ("RTL_ALT", 1.0)]
    assert settings_pushed("land_speed_set_mps <= cruise_speed_set_mps and odd >= battery_low_set_v", describe()) == ()
    assert settings_pushed("altitude_m >= altitude_est_m and mode >= fence_type_set", describe()) == ()


def test_a_rule_about_a_lost_sensor_is_told_from_one_that_excuses_it() -> None:
    assert sensor_lost({"formula": "always ((gps_ok == 0 and armed == 1) implies failsafe_gps == 1)"})
    assert sensor_lost({"formula": "always (rise(armed == 1) implies prev(gps_ok == 1))"})
    assert not sensor_lost({"formula": "always ((gps_ok == 1 and armed == 1) implies climb_mps > 0)"})
    assert not sensor_lost({"formula": "always ((rc_present == 0 or rc1_pwm <= 1520) implies climb_mps > 0)"})


def test_a_mode_that_a_rule_waits_for_to_begin_or_end_stands_for_all_it_names() -> None:
    formula = "always (rise(mode == FLIP) implies prev(mode == ACRO or mode == ALT_HOLD))"
    assert modes_named(formula) == ("FLIP",)
    assert modes_named("always (mode == RTL and fall((mode == LAND)) implies landed == 1)") == ("LAND",)


def test_a_rule_that_waits_for_the_ground_is_given_the_time_to_get_there() -> None:
    assert (
        quiet_asked_s("always (rise(landed == 1) and mode == RTL implies home_distance_m <= 3)", {"wait_s": 12.0})
        > 45.0
    )
    assert quiet_asked_s("always (landed == 1 and mode == RTL implies armed == 0)", {"wait_s": 12.0}) == 13.0


def test_a_setting_as_it_was_at_some_moment_is_asked_for_all_the_same() -> None:
    asked = settings_asked(
        "always ((latch(pilot_takeoff_set_m, landed == 0)) >= 2 implies altitude_m >= 1)", describe()
    )
    assert [(entry.name, value) for entry, value in asked] == [("PILOT_TKOFF_ALT", 400.0)]


def test_faults_of_a_sensor_that_a_rule_asks_to_be_lost_are_its_own() -> None:
    silent = faults_asked("always (rise(armed == 1) implies not prev(lasting[1] baro_ok == 0))", describe())
    assert "SIM_BARO_DISABLE" in silent
    assert all("BARO" in name for name in silent)
    assert faults_asked("always (baro_ok == 1 implies altitude_m >= 0)", describe()) == ()
    assert faults_asked("always (rc_present == 0 implies mode == RTL)", describe()) == ("SIM_RC_FAIL",)
