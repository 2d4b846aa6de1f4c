"""Can a binary fly this test case? Said before anything is started."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from saflite.contract.errors import Refused
from saflite.contract.target_info import SettingInfo, check_settings
from saflite.contract.test_case import Scenario, Stimulus, TestCase
from saflite.flight.autopilots.external.inputs import check_parameter
from saflite.flight.autopilots.external.listing import Listing

TIME_LIMIT_MAX_S = 3600.0
ALTITUDE_MAX_M, WIND_MAX_MPS = 500.0, 15.0


def check_test_case(
    test_case: TestCase,
    listing: Listing,
    *,
    settings: Mapping[str, SettingInfo],
    start_modes: Collection[str],
    items_max: int,
    check_stimulus: Callable[[Stimulus, Collection[str], str], None],
) -> None:
    """Raise Refused for unknown parameters, settings, modes, commands, or numbers without sense."""
    scenario, known = test_case.scenario, listing.parameters
    if not 0.0 < scenario.time_limit_s <= TIME_LIMIT_MAX_S:
        raise Refused("time_limit_s", expected=f"above 0, at most {TIME_LIMIT_MAX_S:g}", got=scenario.time_limit_s)
    wind = scenario.wind
    calm = 0.0 <= wind.mean_mps <= WIND_MAX_MPS and 0.0 <= wind.gust_mps <= WIND_MAX_MPS
    if not calm or wind.gust_period_s <= 0.0:
        raise Refused("wind", expected=f"speeds of 0 to {WIND_MAX_MPS:g} m/s, a period above 0", got=wind)
    check_settings(test_case.target.settings, settings, test_case.target.name)
    for name in test_case.target.parameters:
        check_parameter(name, known, "target.parameters")
    _check_start(scenario, start_modes, items_max)
    for index, stimulus in enumerate(test_case.stimuli):
        check_stimulus(stimulus, known, f"stimulus {index}")


def _check_start(scenario: Scenario, modes: Collection[str], items_max: int) -> None:
    mission, start = scenario.mission, scenario.start
    if mission is not None and not 0 < len(mission.items) <= items_max:
        raise Refused("mission", where=mission.name, expected=f"1 to {items_max} items", got=len(mission.items))
    if mission is not None or start is None:
        return
    if start.mode not in modes:
        expected = f"one of {', '.join(modes)} (AUTO needs a mission)"
        raise Refused("start mode", expected=expected, got=repr(start.mode))
    if not 0.0 <= start.altitude_m <= ALTITUDE_MAX_M:
        raise Refused("start altitude_m", expected=f"0 to {ALTITUDE_MAX_M:g}", got=start.altitude_m)
