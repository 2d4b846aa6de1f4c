"""What a flight leaves behind: how it ended and a trace of named signals."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.blobs import BLOBS_PER_RESULT_MAX, BlobRef
from saflite.contract.bounds import ITEMS_MAX, Count, Number, Samples, Seconds, Text, Word, told
from saflite.contract.errors import Refused
from saflite.contract.ids import digest
from saflite.contract.names import DigestOrNone, Name, NameOrNone, ShortId
from saflite.contract.test_case import Stimulus
from saflite.contract.wire import UNREADABLE, unpack

Ending = Literal["completed", "crashed", "timed_out", "autopilot_died", "wedged", "infra", "lost"]
"""How an attempt ended; a closed list.

completed       the mission or the stimulus sequence ran to its end
crashed         the vehicle hit something hard or left the flight envelope for good
timed_out       simulated time ran out
autopilot_died  the autopilot process or its code failed (signal, panic): a finding
wedged          no progress in wall-clock time; the simulator was killed
infra           our side could not run it (bring-up, disk): retried, never a violation
lost            the worker vanished with it: retried, never a violation
"""

Purpose = Literal["search", "confirm", "check", "shrink", "shrunk", "replay"]
"""Why a test case is flown.

search   the first flight of a selected test case; the only one that counts against the budget
confirm  a re-flight of one that violated, under noise of its own
check    a first flight flown over again, to see that the farm repeats it bit by bit
shrink   a smaller test case is tried
shrunk   the smallest one found is flown and re-flown
replay   an earlier flight is flown again, outside of any campaign
"""

UNTOLD: frozenset[Purpose] = frozenset({"check", "shrink"})
"""Purposes whose flights are counted and written down, but not announced one by one."""

AUTOPILOT_ALIVE = "autopilot-alive"
"""The policy that a flight ending as `autopilot_died` breaks, whatever else a campaign checks; it has no file."""

FLOWN_ENDINGS: frozenset[Ending] = frozenset({"completed", "crashed", "timed_out", "autopilot_died"})
"""Endings that say something about the vehicle; the others only about the farm."""


class TraceMessage(msgspec.Struct, frozen=True, kw_only=True):
    """A text the autopilot or the world gave during the flight."""

    at_s: Number
    text: Text
    severity: Literal["info", "warning", "error"] = "info"


class Trace(msgspec.Struct, frozen=True, kw_only=True):
    """Evenly sampled signals of one flight.

    `signals` maps a name with its unit last (`altitude_m`, `obstacle_distance_m`) to little-endian float32 bytes;
    all have the same number of samples, `step_s` apart, the first at time 0.
    """

    step_s: Number
    signals: Annotated[dict[Word, bytes], msgspec.Meta(max_length=1_000)]
    messages: Annotated[tuple[TraceMessage, ...], msgspec.Meta(max_length=ITEMS_MAX)] = ()

    def array(self, name: str) -> NDArray[np.float32]:
        """Return one signal, shape (samples,), read-only; raises Refused if the trace has no such signal."""
        if name not in self.signals:
            raise Refused("signal", expected=f"one of {', '.join(sorted(self.signals))}", got=repr(name))
        return np.frombuffer(self.signals[name], dtype="<f4")

    @property
    def samples(self) -> int:
        """Number of samples of every signal."""
        return min((len(data) // 4 for data in self.signals.values()), default=0)

    @property
    def duration_s(self) -> float:
        """Simulated time from the first to the last sample."""
        return max(0, self.samples - 1) * self.step_s


DeliveryAnswer = Literal["accepted", "denied", "timed_out", "late", "unanswered"]
"""What became of a stimulus when it was given.

accepted    the autopilot took it, or it is of a kind that cannot be refused (a stick, a sensor fault)
denied      the autopilot refused it: no cause of anything
timed_out   an answer was due and did not come
late        it was given, but later than the test case says
unanswered  no answer was asked for or is known
"""


class Delivered(msgspec.Struct, frozen=True, kw_only=True):
    """How one stimulus of the test case was given: `index` into `TestCase.stimuli`, simulated time, the answer.

    `changed` names the signals that it changed at once, with their new values: what a sample taken right after it would
    hold, before the next stimulus and before the autopilot went on. So the oracle knows what held between two stimuli
    of one instant, of which the trace shows only what was left in the end. Empty where the target cannot tell.
    """

    index: Count
    at_s: Number
    answer: DeliveryAnswer = "accepted"
    message: Text = ""
    changed: Samples = {}


class Artefact(msgspec.Struct, frozen=True, kw_only=True):
    """A named file a flight left behind (autopilot log, console text, core reason): its name and its blob."""

    name: Name
    blob: BlobRef


class FlightRecord(NamedTuple):
    """What a session's `fly` returns: how the flight ended and its trace, None if there is none.

    `delivered` has one entry per stimulus that was given, in the order given; None where the target cannot tell (then
    the plan stands for it). `artefacts` are named files as bytes.
    """

    ending: Ending
    trace: Trace | None
    message: str = ""
    delivered: tuple[Delivered, ...] | None = None
    artefacts: tuple[tuple[str, bytes], ...] = ()


SAID_CHARS_MAX = 2**22
"""Of all texts of a flight together; the whole trace has 64 MiB."""


def readable(record: FlightRecord) -> FlightRecord:
    """Return a record whose words are no more than messages may hold; of too many texts the first stay, and the last.

    An autopilot says what it likes, and a flight that nobody can read is judged by nobody.
    """
    trace, delivered = record.trace, record.delivered
    if trace is not None:
        trace = msgspec.structs.replace(trace, messages=_readable(trace.messages))
    if delivered is not None:
        delivered = tuple(msgspec.structs.replace(one, message=told(one.message)) for one in delivered)
    return record._replace(trace=trace, delivered=delivered, message=told(record.message))


def _readable(said: tuple[TraceMessage, ...]) -> tuple[TraceMessage, ...]:
    kept, left = list[TraceMessage](), SAID_CHARS_MAX
    for one in said[: ITEMS_MAX - 1]:
        text = told(one.text)
        left -= len(text)
        if left < 0:
            break
        kept.append(msgspec.structs.replace(one, text=text))
    return (*kept, *(msgspec.structs.replace(one, text=told(one.text)) for one in said[len(kept) :][-1:]))


class Flight(msgspec.Struct, frozen=True, kw_only=True):
    """The record of one attempt. `trace_digest` is the SHA-256 of the trace's content: equal digest, bit-equal flight.

    `trace` names the packed trace, None if there is none; `build` is the digest of what flew; `delivered` tells how
    each stimulus was given, None where that is not known.
    """

    test_case: ShortId
    flight_index: Count
    ending: Ending
    simulated_s: Seconds = 0.0
    wall_s: Seconds = 0.0
    trace_digest: DigestOrNone = ""
    trace: BlobRef | None = None
    worker: NameOrNone = ""
    message: Text = ""
    build: Word = ""
    delivered: Annotated[tuple[Delivered, ...], msgspec.Meta(max_length=ITEMS_MAX)] | None = None
    artefacts: Annotated[tuple[Artefact, ...], msgspec.Meta(max_length=BLOBS_PER_RESULT_MAX)] = ()

    @property
    def blobs(self) -> tuple[BlobRef, ...]:
        """All that the flight left behind."""
        trace = () if self.trace is None else (self.trace,)
        return (*trace, *(artefact.blob for artefact in self.artefacts)) if self.artefacts else trace


class Given(NamedTuple):
    """A stimulus as it was given: `stimulus.at_s` is when, in simulated time."""

    stimulus: Stimulus
    answer: DeliveryAnswer
    message: str = ""

    @property
    def is_cause(self) -> bool:
        """Whether the autopilot may have acted on it: a denied or timed-out stimulus is no cause of anything."""
        return self.answer not in ("denied", "timed_out")


def given(stimuli: Sequence[Stimulus], delivered: tuple[Delivered, ...] | None) -> tuple[Given, ...]:
    """Return the stimuli as they were given, in order of time; one that was never given is left out.

    Args:
        stimuli: the plan, `TestCase.stimuli`.
        delivered: what became of it, `Flight.delivered`; None where that is not known (logs of others, targets that
            cannot tell): then the plan stands for it, unanswered.

    Raises:
        Refused: `delivered` tells of a stimulus that the plan does not hold.
    """
    if delivered is None:
        return tuple(Given(one, "unanswered") for one in sorted(stimuli, key=lambda stimulus: stimulus.at_s))
    for one in delivered:
        if not 0 <= one.index < len(stimuli):
            raise Refused("delivered", expected=f"an index below {len(stimuli)}", got=one.index)
    return tuple(
        Given(msgspec.structs.replace(stimuli[one.index], at_s=one.at_s), one.answer, one.message)
        for one in sorted(delivered, key=lambda entry: entry.at_s)
    )


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")
TRACE_BYTES_MAX = 64 * 2**20
STEP_MIN_S, STEP_MAX_S = 1e-6, 3600.0
SAMPLES_MAX = 2**20
"""Of a signal: 14 hours at 20 Hz. What judges a flight takes a kilobyte a sample and more."""


def pack_trace(trace: Trace) -> bytes:
    """Return the trace as compressed bytes, the form it travels and is stored in."""
    folded = {name: _folded(data) for name, data in trace.signals.items()}
    return zlib.compress(_ENCODER.encode(msgspec.structs.replace(trace, signals=folded)))


def _folded(data: bytes) -> bytes:
    """Return float32 samples as differences of their bit patterns, by byte plane: what hardly changes becomes zeros."""
    if len(data) % 4:
        return data  # refused when read
    step = np.diff(np.frombuffer(data, "<u4"), prepend=np.uint32(0))
    sign_last = (step << np.uint32(1)) ^ -(step >> np.uint32(31))
    return sign_last.astype("<u4").view(np.uint8).reshape(-1, 4).T.tobytes()


def _unfolded(data: bytes) -> bytes:
    """Return what `_folded` was given."""
    if len(data) % 4:
        return data
    sign_last = np.ascontiguousarray(np.frombuffer(data, np.uint8).reshape(4, -1).T).view("<u4").ravel()
    step = (sign_last >> np.uint32(1)) ^ -(sign_last & np.uint32(1))
    return np.cumsum(step, dtype=np.uint32).astype("<u4").tobytes()


def trace_digest(trace: Trace) -> str:
    """Return the SHA-256 of the trace's content (before compression)."""
    return digest(_ENCODER.encode(trace))


def unpack_trace(data: bytes, trace_digest: str = "") -> Trace:
    """Return the trace in `data`.

    Raises:
        Refused: it is damaged, larger than 64 MiB unpacked, of more than `SAMPLES_MAX` samples, or not the one with
            this digest, if one is given.
    """
    inflate = zlib.decompressobj()
    try:
        content = inflate.decompress(data, TRACE_BYTES_MAX)
        if inflate.unconsumed_tail or not inflate.eof:
            raise Refused("trace", expected="a whole packed trace of at most 64 MiB", got=f"{len(data)} bytes")
        folded: Trace = unpack(content, Trace)
    except (zlib.error, *UNREADABLE) as fault:
        raise Refused("trace", expected="a packed trace", got=str(fault)) from fault
    check_trace(folded)  # what is folded is as long as what is not
    trace = msgspec.structs.replace(folded, signals={name: _unfolded(data) for name, data in folded.signals.items()})
    if trace_digest and digest(_ENCODER.encode(trace)) != trace_digest:
        raise Refused("trace", expected=f"the one with the digest {trace_digest[:16]!r}...", got="another trace")
    return trace


def check_trace(trace: Trace) -> None:
    """Raise Refused unless samples are evenly spaced in time, not too many, and as many of every signal."""
    if not (math.isfinite(trace.step_s) and trace.step_s > 0.0):
        raise Refused("trace", expected="a finite step above 0 s", got=trace.step_s)
    if not STEP_MIN_S <= trace.step_s <= STEP_MAX_S:
        raise Refused("trace", expected=f"a step of {STEP_MIN_S:g} to {STEP_MAX_S:g} s", got=trace.step_s)
    sizes = {len(data) for data in trace.signals.values()}
    if any(size > 4 * SAMPLES_MAX for size in sizes):
        raise Refused("trace", expected=f"at most {SAMPLES_MAX} samples", got=max(sizes) // 4)
    if len(sizes) > 1 or any(size % 4 for size in sizes):
        raise Refused("trace", expected="signals of one length, four bytes a sample", got=f"{sorted(sizes)[:4]} bytes")


def matches_digest(data: bytes, trace_digest: str) -> bool:
    """Return whether a packed trace is whole and its content has this digest."""
    try:
        unpack_trace(data, trace_digest)
    except Refused:
        return False
    return True
