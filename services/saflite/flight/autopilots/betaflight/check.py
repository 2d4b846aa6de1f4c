"""Can the target fly this test case? Said before anything is started."""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.contract.target_info import check_settings
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.betaflight import user_memory
from saflite.flight.autopilots.betaflight.describe import SETTINGS, TIME_LIMIT_MAX_S
from saflite.flight.autopilots.betaflight.firmware import Variant
from saflite.flight.autopilots.betaflight.inputs import check_setting, check_stimulus
from saflite.flight.autopilots.betaflight.switches import pilot_modes

ALTITUDE_MAX_M, WIND_MAX_MPS = 120.0, 15.0


def check_test_case(test_case: TestCase, name: str, variant: Variant) -> None:
    """Raise Refused for what this target does not have, or numbers without sense."""
    scenario = test_case.scenario
    if not 0.0 < scenario.time_limit_s <= TIME_LIMIT_MAX_S:
        raise Refused("time_limit_s", expected=f"above 0, at most {TIME_LIMIT_MAX_S:g}", got=scenario.time_limit_s)
    if scenario.mission is not None or scenario.obstacles:
        raise Refused("scenario", where=name, expected="a start state", got="a mission or obstacles")
    wind = scenario.wind
    calm = 0.0 <= wind.mean_mps <= WIND_MAX_MPS and 0.0 <= wind.gust_mps <= WIND_MAX_MPS
    if not calm or wind.gust_period_s <= 0.0:
        raise Refused("wind", expected=f"speeds of 0 to {WIND_MAX_MPS:g} m/s, a period above 0", got=wind)
    start = scenario.start
    if start is not None and start.mode not in pilot_modes(variant.gps):
        raise Refused("start mode", expected=f"one of {', '.join(pilot_modes(variant.gps))}", got=repr(start.mode))
    if start is not None and not 0.0 <= start.altitude_m <= ALTITUDE_MAX_M:
        raise Refused("start altitude_m", expected=f"0 to {ALTITUDE_MAX_M:g}", got=start.altitude_m)
    check_settings(test_case.target.settings, SETTINGS, name)
    user_memory.read(test_case.target.settings)
    for parameter, value in test_case.target.parameters.items():
        check_setting(parameter, value, variant, "target.parameters", strict=True)
    for index, stimulus in enumerate(test_case.stimuli):
        check_stimulus(stimulus, variant, f"stimulus {index}")
