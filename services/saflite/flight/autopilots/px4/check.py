"""Can PX4 fly this test case? Said before anything is started."""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external import check
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4.describe import COMPANION, SETTINGS, START_MODES
from saflite.flight.autopilots.px4.inputs import check_stimulus
from saflite.flight.mission import waypoints

ITEMS_MAX = 500


def check_test_case(test_case: TestCase, listing: Listing) -> None:
    """Raise Refused for unknown parameters, settings, modes, commands, or numbers without sense."""
    mission = test_case.scenario.mission
    if test_case.target.settings.get(COMPANION, "none") != "none":
        if mission is None:
            raise Refused("companion", expected="a mission for it to fly", got="none")
        waypoints(mission)
    check.check_test_case(
        test_case,
        listing,
        settings=SETTINGS,
        start_modes=START_MODES,
        items_max=ITEMS_MAX,
        check_stimulus=check_stimulus,
    )
