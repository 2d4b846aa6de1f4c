"""What the worker loop (`runtime/worker.py`) is told and what it answers: events in, instructions out."""

from __future__ import annotations

from typing import Literal, NamedTuple

from saflite.contract.join import Joined
from saflite.contract.work import Ask, Grant, Heartbeat, Lease, Orders, Receipt, Report, Result, Stage, TargetBuild

LeftFor = Literal["done", "refused", "unanswered", "stuck"]
"""Why a worker leaves.

It was told to or has nothing to do any more, the books will not have it, nobody answers, work does not end that it was
told to drop.
"""


class WorkerConfig(NamedTuple):
    """How this worker works. `prefetch` leases are held ready beyond the `parallel` ones being worked.

    With a `patience_s` it leaves once nobody has answered it for so long; 0 is patience without end.
    """

    worker: str
    stage: Stage
    parallel: int = 1
    prefetch: int = 0
    poll_s: float = 5.0
    targets: tuple[TargetBuild, ...] = ()
    patience_s: float = 0.0


class Key(NamedTuple):
    """A lease and its epoch: one attempt."""

    lease_id: str
    epoch: int


# ---- events -------------------------------------------------------------------------------------------------------


class Tick(NamedTuple):
    """Time has passed."""

    resident_mib: float = 0.0
    processor_s: float = 0.0


class Answered(NamedTuple):
    """The answer to a wish to join; None if nobody answered."""

    joined: Joined | None


class Granted(NamedTuple):
    """The answer to an ask; None if nobody answered."""

    grant: Grant | None


class Ordered(NamedTuple):
    """The answer to a heartbeat; None if nobody answered."""

    orders: Orders | None


class Received(NamedTuple):
    """The answer to a report; None if nobody answered, `refused` if the books could not read it."""

    key: Key
    receipt: Receipt | None
    refused: bool = False


class Done(NamedTuple):
    """A piece of work has ended."""

    key: Key
    result: Result


class Found(NamedTuple):
    """A result an earlier life of this worker left in the spool."""

    report: Report


class StopAsked(NamedTuple):
    """Somebody wants this worker to end (signal)."""

    why: str


class DrainAsked(NamedTuple):
    """This worker is needed no more: it finishes what it holds, asks for nothing new, then ends."""


Event = Tick | Answered | Granted | Ordered | Received | Done | Found | StopAsked | DrainAsked


# ---- instructions -------------------------------------------------------------------------------------------------


class SendJoin(NamedTuple):
    """Ask to be let in."""

    timeout_s: float


class SendAsk(NamedTuple):
    """Ask for work."""

    ask: Ask
    timeout_s: float


class SendBeat(NamedTuple):
    """Send a heartbeat."""

    beat: Heartbeat
    timeout_s: float


class SendReport(NamedTuple):
    """Hand a result in."""

    report: Report
    timeout_s: float


class Renew(NamedTuple):
    """Connect to the bus anew: nobody has answered for a while, though the link may look alive."""


class Begin(NamedTuple):
    """Start the work of a lease."""

    lease: Lease


class Cancel(NamedTuple):
    """Tell running work to end early."""

    key: Key


class Keep(NamedTuple):
    """Write a result to the spool, before it is sent."""

    report: Report


class Forget(NamedTuple):
    """Remove a result from the spool."""

    key: Key


class Leave(NamedTuple):
    """End the process."""

    why: str
    left_for: LeftFor = "done"


Instruction = Renew | SendJoin | SendAsk | SendBeat | SendReport | Begin | Cancel | Keep | Forget | Leave
