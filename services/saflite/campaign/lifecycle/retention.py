"""What a run keeps: one recording of each behaviour, with its trace in it, and no more than the campaign allows.

The digest of everything let go stays in the books. Where flights repeat bit by bit, any of them can be flown again.
"""

from __future__ import annotations

from collections.abc import Callable

from saflite.campaign.engine.core import Core
from saflite.campaign.engine.journal import Pruned
from saflite.campaign.lifecycle.confirmation import Trial
from saflite.campaign.scheduling.work_keys import JudgeKey
from saflite.contract.blobs import BlobRef
from saflite.contract.flight import Flight

MB = 10**6


def is_full(core: Core) -> bool:
    """Return whether as much is kept as the campaign allows; the first time it is, that is announced."""
    limit_mb = core.campaign.keep_mb
    if not core.full and sum(hold.size_bytes for hold in core.holds.values()) > limit_mb * MB:
        core.full = True
        core.fault("keep_mb", f"{limit_mb} MB are kept: finds from here on leave no recordings")
    return core.full


def keep(core: Core, trial: Trial) -> bool:
    """Keep what the flights of a confirmed or refuted find left, or let go of it; return whether it is kept.

    Re-flights that can be flown again bit by bit leave no traces, only their digests.
    """
    full, everything = is_full(core), core.campaign.record == "all"
    repeatable = core.confirm.repeats == "bitwise" and not everything
    for index, note in trial.flights.items():
        flight, is_first = note.flight, index == trial.first
        if not is_first and (note.given_up or not (note.violated or everything)):
            continue  # let go of when it was given up or judged
        if full:
            core.let_go(*flight.blobs)
        elif not is_first and repeatable and flight.trace is not None:
            core.let_go(flight.trace)
        core.flush(*flight.blobs)
    return not full


def needed(core: Core, flight_of: Callable[[JudgeKey], Flight]) -> frozenset[BlobRef]:
    """Return the blobs that work under way needs."""
    flights = [note.flight for trial in core.all_trials() for note in trial.flights.values()]
    flights += [flight_of(task.key) for task in core.tasks if isinstance(task.key, JudgeKey)]
    flights += [parts.flight for parts in core.records.values()]
    return frozenset(blob for flight in flights for blob in flight.blobs)


def prune(core: Core, entry: Pruned) -> None:
    """Let go of blobs whoever needed them."""
    for blob in entry.blobs:
        if blob.digest in core.holds:
            core.drop(blob.digest)
    for test_case, flight_index in entry.recordings:
        core.out.row("recordings", test_case, flight_index, "", 0)
    core.full = False
