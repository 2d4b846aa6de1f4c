"""Can ArduCopter fly this test case? Said before anything is started."""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.contract.test_case import Scenario, TestCase
from saflite.flight.autopilots.ardupilot.inputs import check_stimulus
from saflite.flight.autopilots.ardupilot.settings import SETTINGS, own_physics
from saflite.flight.autopilots.ardupilot.telemetry import MODES
from saflite.flight.autopilots.external import check
from saflite.flight.autopilots.external.listing import Listing

ITEMS_MAX = 700
START_MODES = tuple(name for name in MODES if name != "AUTO")


def check_test_case(test_case: TestCase, listing: Listing) -> None:
    """Raise Refused for unknown parameters, settings, modes, commands, or numbers without sense."""
    if own_physics(test_case):
        _check_own_physics(test_case.scenario)
    check.check_test_case(
        test_case,
        listing,
        settings=SETTINGS,
        start_modes=START_MODES,
        items_max=ITEMS_MAX,
        check_stimulus=check_stimulus,
    )


def _check_own_physics(scenario: Scenario) -> None:
    """Raise Refused for what only our world has."""
    if scenario.obstacles:
        raise Refused("physics native", expected="no obstacles", got=len(scenario.obstacles), fix="physics = jsbsim")
    if scenario.wind.mean_mps or scenario.wind.gust_mps:
        fix = "set SIM_WIND_SPD, SIM_WIND_DIR, SIM_WIND_TURB, or physics = jsbsim"
        raise Refused("physics native", expected="no wind of the scenario", got=scenario.wind, fix=fix)
