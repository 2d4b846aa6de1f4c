"""What a PX4 binary says of its parameters; it is started for that where it was never asked."""

from __future__ import annotations

import numpy as np

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external import listing
from saflite.flight.autopilots.external.link import Stopped
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import FailedBringUp, Place
from saflite.flight.autopilots.px4.binary import Binary, cache_folder
from saflite.flight.autopilots.px4.bring_up import Aircraft
from saflite.flight.autopilots.px4.settings import NO_LOG


def known(binary: Binary) -> Listing | None:
    """Return what is remembered of a binary, None where it was never asked."""
    return listing.known(cache_folder(), binary.digest)


def ask(binary: Binary, place: Place) -> Listing:
    """Return what a binary says of its parameters; it is started for that where it was never asked.

    Raises:
        Unavailable: it does not come up, or does not tell all.
    """
    remembered = known(binary)
    if remembered is not None:
        return remembered
    quiet = {name: str(round(value)) for name, value in NO_LOG.items()}
    try:
        aircraft = Aircraft(binary, place, quiet, np.zeros((0, 8)))
    except FailedBringUp as fault:
        raise Unavailable(f"{binary.version}: {fault}") from fault
    try:
        found = Listing(binary=binary.digest, parameters=listing.listed(aircraft.client))
    except Stopped as fault:
        raise Unavailable(f"{binary.version}: {aircraft.trouble(fault.came)}") from fault
    finally:
        aircraft.close()
    listing.remember(cache_folder(), found)
    return found
