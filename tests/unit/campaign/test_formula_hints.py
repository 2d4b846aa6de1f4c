"""What the text of a rule tells a search: modes, failsafes, quiet, settings."""

from __future__ import annotations

from saflite.campaign.presets.formula_hints import (
    QUIET_MAX_S,
    failsafes_named,
    modes_named,
    quiet_asked_s,
    settings_asked,
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
