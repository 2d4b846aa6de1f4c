"""A lease to record becomes an MCAP file, left as a blob. The books give it its name in the run folder.

A recording that was leased twice, because the first worker was slow or died before its report, is made twice; the books
keep the one they accept.
"""

from __future__ import annotations

from saflite.contract.blobs import Blobs
from saflite.contract.clock import Clock
from saflite.contract.errors import Refused
from saflite.contract.service import Cancelled, Service
from saflite.contract.work import RecordResult, RecordWork, Result, Stage, Work


def open_service(blobs: Blobs, clock: Clock) -> Service:
    """Return a recorder; `clock` gives the moment recordings are dated with."""
    return Recorder(blobs, clock)


class Recorder:
    """Makes one MCAP per flight."""

    stage: Stage = "record"
    cursor = -1
    parallel = 1

    def __init__(self, blobs: Blobs, clock: Clock) -> None:
        self._blobs, self._clock = blobs, clock

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Make the recording; raises Refused for a damaged trace, BlobMissing for none, Unavailable for the disk."""
        from saflite.recorder import mcap

        assert isinstance(work, RecordWork), f"the recorder was given {type(work).__name__}"
        flight = work.flight
        if flight.trace is None:
            raise Refused("flight", expected="one with a trace", got=flight.ending)
        began_s = self._clock.unix_s() - max(flight.simulated_s, flight.wall_s)
        blob = self._blobs.put(mcap.write(work, self._blobs.get(flight.trace), began_s))
        return RecordResult(test_case=flight.test_case, flight_index=flight.flight_index, blob=blob)

    def close(self) -> None:
        """Nothing is held."""
