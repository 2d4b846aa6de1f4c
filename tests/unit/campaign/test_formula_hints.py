"""What the text of a rule tells a search: modes, failsafes, quiet, settings."""

from __future__ import annotations

from saflite.campaign.presets.formula_hints import (
    QUIET_MAX_S,
    failsafes_named,
    modes_named,
    quiet_asked_s,
    settings_asked,
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


def test_numbers_with_a_unit_and_defaults_are_asked_of_no_setting() -> None:
    assert settings_asked("always (rtl_altitude_set_m >= 15 implies battery_low_action_set >= 2)", describe()) == ()
    assert quiet_asked_s("always (altitude_m >= 0)") == 0.0
    assert quiet_asked_s("always (lasting[500] (altitude_m >= 0) implies landed == 1)") == QUIET_MAX_S


def test_a_rule_with_odd_parts_tells_what_it_can() -> None:
    assert whole_formula({"formula": 3, "terms": "none", "constants": []}) == "3"
