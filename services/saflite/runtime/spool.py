"""Results a worker has not yet been given a receipt for, kept on disk so that they survive the worker.

One small file per result in a folder per worker name: `<lease>.<epoch>.report`, its SHA-256 first, written aside and
renamed into place. Not fsynced on purpose: a machine that loses power loses the flight too, and its lease is freed.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path

from saflite.contract import wire
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.ids import digest
from saflite.contract.outside import read_bytes
from saflite.contract.work import Report
from saflite.evidence.files import make_folder

log = logging.getLogger(__name__)

_DIGEST_BYTES = 64


class Spool:
    """The folder of one worker. `folder` None keeps nothing (a dead worker's results are then flown again).

    A disk that has become full or read-only costs no flight: what cannot be kept or cleared away is said, no more.
    A run folder it lies in, `within`, is not made anew where it was moved away.
    """

    def __init__(self, folder: Path | None, within: Path | None = None) -> None:
        self._folder = folder
        if folder is not None:
            try:
                make_folder(folder, within if within in folder.parents else None)
            except OSError as fault:
                log.warning("results will not be spooled: %s", fault)
            for leftover in folder.glob("*.part"):
                _remove(leftover)

    def keep(self, report: Report) -> None:
        """Write the report; raises Unavailable if the disk does not take it (the report is still sent)."""
        if self._folder is None:
            return
        data = wire.encode(report)
        path = self._path(report.lease_id, report.epoch)
        part = path.with_suffix(".part")
        try:
            part.write_bytes(digest(data).encode() + data)
            part.replace(path)
        except OSError as fault:
            _remove(part)  # on a read-only disk that fails, too, even where nothing stands there
            raise Unavailable(f"spool {self._folder}: {fault}") from fault

    def forget(self, lease_id: str, epoch: int) -> None:
        """Remove a report; not having it is no fault."""
        if self._folder is not None:
            _remove(self._path(lease_id, epoch))

    def waiting(self) -> list[Report]:
        """Return the reports left by an earlier life of this worker; damaged ones are set aside and said."""
        reports: list[Report] = []
        for path in sorted(self._folder.glob("*.report")) if self._folder is not None else []:
            try:
                reports.append(_read(path))
            except Refused as fault:
                log.warning("spooled result set aside: %s", fault)
                with suppress(OSError):
                    path.rename(path.with_suffix(".damaged"))
        return reports

    def _path(self, lease_id: str, epoch: int) -> Path:
        assert self._folder is not None
        safe = "".join(char if char.isalnum() or char in "-_" else "_" for char in lease_id)
        return self._folder / f"{safe}.{epoch}.report"


def _remove(path: Path) -> None:
    """Remove a file if the disk lets us; a result that stays is reported once more, which changes nothing."""
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _read(path: Path) -> Report:
    data = read_bytes(path, "spooled result", wire.MESSAGE_BYTES_MAX + _DIGEST_BYTES)
    head, body = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if digest(body).encode() != head:
        raise Refused("spooled result", where=str(path), expected="bytes that fit their digest", got="other bytes")
    return wire.decode(body, Report)
