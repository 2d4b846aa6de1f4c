"""Can PX4 fly this test case? Said before anything is started."""

from __future__ import annotations

from functools import partial

from saflite.contract.errors import Refused
from saflite.contract.test_case import Scenario, TestCase
from saflite.flight.autopilots.external import check
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4.describe import SETTINGS, START_MODES
from saflite.flight.autopilots.px4.inputs import check_stimulus
from saflite.flight.autopilots.px4.settings import OWN_KIND, PILOT, companion_of, own_physics
from saflite.flight.mission import waypoints

ITEMS_MAX = 500


def check_test_case(test_case: TestCase, listing: Listing) -> None:
    """Raise Refused for unknown parameters, settings, modes, commands, or numbers without sense."""
    mission, own = test_case.scenario.mission, own_physics(test_case)
    if companion_of(test_case):
        if mission is None:
            raise Refused("companion", expected="a mission for it to fly", got="none")
        waypoints(mission)
    if companion_of(test_case) == PILOT and any(one.kind == "stick" for one in test_case.stimuli):
        raise Refused("companion pilot", expected="no stick among the inputs: the pilot holds them", got="one")
    if own:
        _check_own_physics(test_case.scenario, listing)
    check.check_test_case(
        test_case,
        listing,
        settings=SETTINGS,
        start_modes=START_MODES,
        items_max=ITEMS_MAX,
        check_stimulus=partial(check_stimulus, own_physics=own),
    )


def _check_own_physics(scenario: Scenario, listing: Listing) -> None:
    """Raise Refused for what PX4's own physics does not have."""
    if OWN_KIND not in listing.parameters:
        fix = "physics = jsbsim, or another build"
        raise Refused("physics sih", expected="a build that starts on it (simulator_sih, 10040)", got="none", fix=fix)
    if scenario.wind.mean_mps or scenario.wind.gust_mps:
        expected = "no wind of the scenario: its air stands still"
        raise Refused("physics sih", expected=expected, got=scenario.wind, fix="physics = jsbsim")
