"""The journal: what happened to the books, in order. Their state is the fold of these entries and nothing else.

Decisions that depend on who asked when (which worker got which work, what counted as lost, what was picked) are
written down as decided, so that a replay never decides again.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from saflite.campaign.engine.track_packing import Track, pack_track, unpack_track
from saflite.campaign.scheduling.work_keys import WorkKey
from saflite.contract import wire
from saflite.contract.blobs import BlobRef
from saflite.contract.control import Control
from saflite.contract.events import Fact
from saflite.contract.work import JudgeResult, Result

SelectedBy = Literal["score", "random"]
How = Literal["lost", "overdue", "undelivered", "handed_back", "refused", "caught_up", "passed_on"]
"""How a lease ended without a result that counts.

lost          its time ran out after the worker had shown that it held it, or the worker vanished, or it was given back
              more often than workers that stop do: an attempt
overdue       the same, but its worker was heard of all the while: what it does hangs
undelivered   no heartbeat ever named it (the grant never arrived), or its worker was still at an older one: no attempt
handed_back   the worker gave it back untouched: no attempt
refused       the result did not fit the work: a failure
caught_up     the worker was only told outcomes: no attempt
passed_on     a mutator failed or was lost where another has not tried yet: it says nothing of the strategy
"""


class Pick(msgspec.Struct, frozen=True, kw_only=True):
    """One test case chosen to be flown, and what chose it."""

    test_case: str
    selected_by: SelectedBy
    score: float
    novelty: float


class Opened(msgspec.Struct, frozen=True, kw_only=True, tag="opened"):
    """The books were opened for the n-th time (`incarnation`), at this wall time."""

    incarnation: int
    unix_s: float


class Granted(msgspec.Struct, frozen=True, kw_only=True, tag="granted"):
    """A piece of work was lent to a worker as attempt `epoch`.

    `model` is the deciding scorer at that moment; `catching_up` marks a mutate lease that only tells outcomes.
    """

    key: WorkKey
    epoch: int
    worker: str
    model: str = ""
    catching_up: bool = False


class Returned(msgspec.Struct, frozen=True, kw_only=True, tag="returned"):
    """A lease ended without a result that counts."""

    key: WorkKey
    epoch: int
    how: How
    message: str = ""


class Settled(msgspec.Struct, frozen=True, kw_only=True, tag="settled"):
    """A result was taken. Traces are not in the journal; they stand as files under their digest."""

    key: WorkKey
    epoch: int
    worker: str
    result: Result


class Selected(msgspec.Struct, frozen=True, kw_only=True, tag="selected"):
    """The flights of a round were chosen, in order of rank."""

    round: int
    picks: tuple[Pick, ...]


class Ordered(msgspec.Struct, frozen=True, kw_only=True, tag="ordered"):
    """An operator's order was taken."""

    control: Control


class Noted(msgspec.Struct, frozen=True, kw_only=True, tag="noted"):
    """Something worth telling that changes nothing in the books but who is there.

    `key` is by which key a worker that comes has joined, empty for the farm's own user; None where that is not known.
    """

    fact: Fact
    key: str | None = None


class TraceMissing(msgspec.Struct, frozen=True, kw_only=True, tag="trace_missing"):
    """The trace of a flight not judged yet is gone or damaged: the flight is flown again."""

    key: WorkKey
    message: str


class GaveUp(msgspec.Struct, frozen=True, kw_only=True, tag="gave_up"):
    """Work nobody came to do was given up: a recording, or a re-flight on a build that no worker has any more."""

    key: WorkKey
    message: str


class Pruned(msgspec.Struct, frozen=True, kw_only=True, tag="pruned"):
    """Somebody let go of blobs that were kept; `recordings` (test case, flight index) lose their names for people."""

    blobs: tuple[BlobRef, ...]
    recordings: tuple[tuple[str, int], ...]


class Placed(msgspec.Struct, frozen=True, array_like=True):
    """What the finds of a test case were found to be: fingerprints of behaviours, by the policy violated."""

    test_case: str
    behaviours: dict[str, str]


Entry = Opened | Granted | Returned | Settled | Selected | Ordered | Noted | TraceMissing | GaveUp | Pruned


class Line(msgspec.Struct, frozen=True, array_like=True):
    """One line of the journal. `at_s` is the books' monotonic clock within one incarnation.

    `placed` is what the entry let the finds of test cases be recognised as, in order: comparing tracks is most of what
    a replay would cost, and another version may compare otherwise. Lines of before it was written have none.
    """

    at_s: float
    entry: Entry
    placed: tuple[Placed, ...] = ()


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")


class _Stored(msgspec.Struct, frozen=True, array_like=True):
    """A line as it is written: the track of a judgement stands beside it, packed; without the end that is empty."""

    at_s: float
    entry: Entry
    track: bytes = b""
    placed: tuple[Placed, ...] = ()


def encode_line(line: Line) -> bytes:
    """Return a journal line as bytes; equal lines give equal bytes."""
    return _ENCODER.encode(_with_track_beside(line))


def decode_line(data: bytes) -> Line:
    """Return the journal line in `data`; raises msgspec.MsgspecError if it is none."""
    stored: _Stored = wire.unpack(data, _Stored)
    return Line(stored.at_s, _with_track(stored) if stored.track else stored.entry, stored.placed)


def _with_track_beside(line: Line) -> tuple[object, ...]:
    entry, track = line.entry, b""
    if isinstance(entry, Settled) and isinstance(entry.result, JudgeResult):
        track = pack_track(entry.result.judgement.track)
        if track:
            entry = _of_track(entry, entry.result, ())
    if line.placed:
        return line.at_s, entry, track, line.placed
    return (line.at_s, entry, track) if track else (line.at_s, entry)


def _with_track(stored: _Stored) -> Settled:
    entry = stored.entry
    if not isinstance(entry, Settled) or not isinstance(entry.result, JudgeResult):
        raise msgspec.DecodeError("a track beside what is no judgement")
    try:
        return _of_track(entry, entry.result, unpack_track(stored.track))
    except ValueError as fault:
        raise msgspec.DecodeError(f"a packed track that cannot be unpacked: {fault}") from fault


def _of_track(entry: Settled, result: JudgeResult, track: Track) -> Settled:
    judgement = msgspec.structs.replace(result.judgement, track=track)
    return msgspec.structs.replace(entry, result=msgspec.structs.replace(result, judgement=judgement))
