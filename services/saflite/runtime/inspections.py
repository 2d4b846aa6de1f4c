"""Results whose blobs are being looked at: each once at a time, however often it is sent meanwhile."""

from __future__ import annotations

from collections import Counter

from saflite.bus.base import Request
from saflite.contract.work import Report, blobs_left


class Inspections:
    """Those under way, with whom to answer."""

    def __init__(self) -> None:
        self._requests: dict[tuple[str, str, int], Request] = {}
        self._blobs: Counter[str] = Counter()

    def begin(self, request: Request, report: Report) -> bool:
        """Note that a result is to be looked at; False if it is already: then this request is the one to answer.

        Looking takes long for large blobs; a worker that hears nothing sends its result again, a hostile one all the
        time.
        """
        is_new = _name(report) not in self._requests
        self._requests[_name(report)] = request
        if is_new:
            self._blobs.update(blob.digest for blob in blobs_left(report.result))
        return is_new

    def end(self, report: Report) -> Request:
        """Forget a result that was looked at, the one that `begin` was first given; returns whom to answer."""
        self._blobs.subtract(blob.digest for blob in blobs_left(report.result))
        self._blobs += Counter()  # forgets those at zero
        return self._requests.pop(_name(report))

    def __contains__(self, digest: object) -> bool:
        """Whether a blob belongs to a result that is being looked at: it must not be dropped meanwhile."""
        return digest in self._blobs


def _name(report: Report) -> tuple[str, str, int]:
    return report.worker, report.lease_id, report.epoch
