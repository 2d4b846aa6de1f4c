"""What tells one autopilot in a process of its own from another, as the target in front of it needs it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from saflite.contract.errors import Unavailable
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external import listing
from saflite.flight.autopilots.external.aircraft import Aircraft
from saflite.flight.autopilots.external.binary import Binaries, Binary
from saflite.flight.autopilots.external.flight import ExternalFlight
from saflite.flight.autopilots.external.link import Stopped
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.autopilots.external.place import FailedBringUp, Place


class Adapter(NamedTuple):
    """An autopilot that people name a binary of.

    `describe` takes binary, list of parameters and what this machine lacks; `check` raises Refused for what the binary
    cannot fly; `flight` makes one flight; `powered_up` starts the binary only to be asked, with parameters that open
    groups: `opening` names those, of the parameters that show without. Where flights can be forked,
    `held` makes one that can be held, and `forkable` says which test cases are flown so. `repeatable` says of which
    test cases a binary's flights repeat bit by bit, where the target says that flights do.
    """

    binaries: Binaries
    describe: Callable[[Binary | None, Listing | None, str], TargetInfo]
    check: Callable[[TestCase, Listing], None]
    flight: Callable[[TestCase, Binary, Listing, Place], ExternalFlight]
    powered_up: Callable[[Binary, Place, Mapping[str, float]], Aircraft]
    held: Callable[[TestCase, Binary, Listing, Place], Any] | None = None
    forkable: Callable[[TestCase], bool] = lambda test_case: False
    opening: Callable[[Mapping[str, Row]], dict[str, float]] = lambda rows: {}
    repeatable: Callable[[TestCase, Binary], bool] = lambda test_case, binary: True

    def known(self, binary: Binary) -> Listing | None:
        """Return what is remembered of a binary's parameters, None where it was never asked."""
        return listing.known(self.binaries.cache_folder(), binary.digest)

    def ask(self, binary: Binary, place: Place) -> Listing:
        """Return what a binary says of its parameters; it is started for that where it was never asked.

        Raises:
            Unavailable: it does not come up, or does not tell all.
        """
        remembered = self.known(binary)
        if remembered is not None:
            return remembered
        rows = self._listed(binary, place, {})
        opening = self.opening(rows)
        if opening:
            rows = {**self._opened(binary, place, opening), **rows}  # values stay those before anything is set
        found = Listing(binary=binary.digest, parameters=rows)
        listing.remember(self.binaries.cache_folder(), found)
        return found

    def _opened(self, binary: Binary, place: Place, opening: Mapping[str, float]) -> dict[str, Row]:
        """Return what shows with groups open; nothing where the build does not come up so: it has its plain list."""
        try:
            return self._listed(binary, place, opening)
        except Unavailable:
            return {}

    def _listed(self, binary: Binary, place: Place, parameters: Mapping[str, float]) -> dict[str, Row]:
        try:
            aircraft = self.powered_up(binary, place, parameters)
        except FailedBringUp as fault:
            raise Unavailable(f"{binary.version}: {fault}") from fault
        try:
            return listing.listed(aircraft.client)
        except Stopped as fault:
            raise Unavailable(f"{binary.version}: {aircraft.trouble(fault.came)}") from fault
        finally:
            aircraft.close()
