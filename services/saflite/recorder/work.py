"""A lease to record becomes an MCAP file in the run folder.

The first recorder to finish wins and everyone reports the same bytes: a recording that was leased twice, because the
first worker was slow or died before its report, is still one file with one digest.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from saflite.contract.clock import Clock
from saflite.contract.errors import Unavailable
from saflite.contract.ids import digest
from saflite.contract.service import Cancelled, Service
from saflite.contract.work import RecordResult, RecordWork, Result, Stage, Work

FOLDER = "recordings"


def open_service(run_dir: Path, clock: Clock) -> Service:
    """Return the recorder of a run; `clock` gives the moment recordings are dated with."""
    return Recorder(run_dir, clock)


class Recorder:
    """Writes one MCAP per flight below `run_dir/recordings`."""

    stage: Stage = "record"
    cursor = -1
    parallel = 1

    def __init__(self, run_dir: Path, clock: Clock) -> None:
        self._run_dir, self._clock = run_dir, clock

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Write the recording unless it is there already; raises Refused for a damaged trace, Unavailable for disk."""
        assert isinstance(work, RecordWork), f"the recorder was given {type(work).__name__}"
        name = f"{FOLDER}/{work.flight.test_case}-{work.flight.flight_index}.mcap"
        path = self._run_dir / name
        try:
            data = path.read_bytes() if path.exists() else self._write(path, work)
        except OSError as fault:
            raise Unavailable(f"recording {path}: {fault}") from fault
        return RecordResult(
            test_case=work.flight.test_case,
            flight_index=work.flight.flight_index,
            file=name,
            digest=digest(data),
            size_bytes=len(data),
        )

    def _write(self, path: Path, work: RecordWork) -> bytes:
        from saflite.recorder import mcap

        began_s = self._clock.unix_s() - max(work.flight.simulated_s, work.flight.wall_s)
        data = mcap.write(work, began_s)
        path.parent.mkdir(parents=True, exist_ok=True)
        if not _create(path, data):
            return path.read_bytes()
        return data

    def close(self) -> None:
        """Nothing is held."""


def _create(path: Path, data: bytes) -> bool:
    """Put the whole file in place at once; returns False if somebody else has done so before."""
    handle, partial = tempfile.mkstemp(dir=path.parent, prefix=".part-")
    try:
        os.fchmod(handle, 0o644)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.link(partial, path)
    except FileExistsError:
        return False
    finally:
        os.unlink(partial)
    return True
