"""Can PX4 fly this test case? Said before anything is started."""

from __future__ import annotations

from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external import check
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4.describe import START_MODES
from saflite.flight.autopilots.px4.inputs import check_stimulus

ITEMS_MAX = 500


def check_test_case(test_case: TestCase, listing: Listing) -> None:
    """Raise Refused for unknown parameters, settings, modes, commands, or numbers without sense."""
    check.check_test_case(
        test_case, listing, settings={}, start_modes=START_MODES, items_max=ITEMS_MAX, check_stimulus=check_stimulus
    )
