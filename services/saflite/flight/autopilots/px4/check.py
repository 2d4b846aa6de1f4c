"""Can the binary fly this test case? Said before anything is started."""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.contract.target_info import check_settings
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external.inputs import check_parameter
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4.describe import START_MODES, TIME_LIMIT_MAX_S
from saflite.flight.autopilots.px4.inputs import check_stimulus

ALTITUDE_MAX_M, WIND_MAX_MPS = 500.0, 15.0
ITEMS_MAX = 500


def check_test_case(test_case: TestCase, listing: Listing) -> None:
    """Raise Refused for unknown parameters, settings, modes, commands, or numbers without sense."""
    scenario, known = test_case.scenario, listing.parameters
    if not 0.0 < scenario.time_limit_s <= TIME_LIMIT_MAX_S:
        raise Refused("time_limit_s", expected=f"above 0, at most {TIME_LIMIT_MAX_S:g}", got=scenario.time_limit_s)
    wind = scenario.wind
    calm = 0.0 <= wind.mean_mps <= WIND_MAX_MPS and 0.0 <= wind.gust_mps <= WIND_MAX_MPS
    if not calm or wind.gust_period_s <= 0.0:
        raise Refused("wind", expected=f"speeds of 0 to {WIND_MAX_MPS:g} m/s, a period above 0", got=wind)
    check_settings(test_case.target.settings, {}, test_case.target.name)
    for name in test_case.target.parameters:
        check_parameter(name, known, "target.parameters")
    _check_start(test_case)
    for index, stimulus in enumerate(test_case.stimuli):
        check_stimulus(stimulus, known, f"stimulus {index}")


def _check_start(test_case: TestCase) -> None:
    mission, start = test_case.scenario.mission, test_case.scenario.start
    if mission is not None and not 0 < len(mission.items) <= ITEMS_MAX:
        raise Refused("mission", where=mission.name, expected=f"1 to {ITEMS_MAX} items", got=len(mission.items))
    if mission is not None or start is None:
        return
    if start.mode not in START_MODES:
        expected = f"one of {', '.join(START_MODES)} (AUTO needs a mission)"
        raise Refused("start mode", expected=expected, got=repr(start.mode))
    if not 0.0 <= start.altitude_m <= ALTITUDE_MAX_M:
        raise Refused("start altitude_m", expected=f"0 to {ALTITUDE_MAX_M:g}", got=start.altitude_m)
