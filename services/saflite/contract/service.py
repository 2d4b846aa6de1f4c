"""What the worker loop needs from a slice: do one piece of work."""

from __future__ import annotations

from typing import Protocol

from saflite.contract.work import Result, Stage, Work


class Cancelled(Protocol):
    """Says whether the lease at hand was cancelled or the worker told to stop; cheap enough to poll."""

    def __call__(self) -> bool:
        """Return True once the work should be dropped."""
        ...


class Service(Protocol):
    """One stage of the pipeline. `saflite.<slice>.work.open_service()` makes it.

    `do` may raise `Refused` (bad input: reported as `Failure`, not retried for ever), `Unavailable` (reported as
    `Failure`, retried elsewhere) or AssertionError (our bug: the process dies and its leases are freed).
    """

    stage: Stage

    @property
    def cursor(self) -> int:
        """The round up to which outcomes were told; -1 where the stage keeps no memory."""
        ...

    @property
    def parallel(self) -> int:
        """How many leases may be worked at once (in threads); 1 for most."""
        ...

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Do the work and return its result."""
        ...

    def close(self) -> None:
        """Free what the service holds, child processes included."""
        ...
