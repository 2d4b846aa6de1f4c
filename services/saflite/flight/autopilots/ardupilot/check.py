"""Can ArduCopter fly this test case? Said before anything is started."""

from __future__ import annotations

from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.ardupilot.inputs import check_stimulus
from saflite.flight.autopilots.ardupilot.telemetry import MODES
from saflite.flight.autopilots.external import check
from saflite.flight.autopilots.external.listing import Listing

ITEMS_MAX = 700
START_MODES = tuple(name for name in MODES if name != "AUTO")


def check_test_case(test_case: TestCase, listing: Listing) -> None:
    """Raise Refused for unknown parameters, settings, modes, commands, or numbers without sense."""
    check.check_test_case(
        test_case, listing, settings={}, start_modes=START_MODES, items_max=ITEMS_MAX, check_stimulus=check_stimulus
    )
