"""Heights of settings, which the vehicle counts from its present home, from home as it was at take-off."""

from __future__ import annotations

ABOVE_HOME = frozenset(
    {
        "rtl_altitude_set_m",
        "rtl_altitude_final_set_m",
        "rtl_descend_altitude_set_m",
        "land_altitude_low_set_m",
        "fence_altitude_max_set_m",
        "fence_altitude_min_set_m",
        "chute_altitude_min_set_m",
    }
)
HOME_STEP_M = 0.5  # arming sets home anew where the vehicle believes to be


def above_start(slot: str, value: float, home_up_m: float) -> float:
    """Return the value of a slot where home is `home_up_m` above that of take-off; 0 is no height but a choice."""
    return value + home_up_m if slot in ABOVE_HOME and value > 0.0 else value
