"""Work is leased: what a worker asks for, is given, and reports back.

A lease is leave to do one piece of work for a while. Its `epoch` says which attempt it is; a result that comes back
under an old epoch is recognised, merged or ignored, never counted twice.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from saflite.contract.blobs import BLOBS_PER_RESULT_MAX, BlobRef
from saflite.contract.bounds import (
    ITEMS_MAX,
    Account,
    Count,
    Document,
    Features,
    Number,
    Place,
    Quantity,
    RngSeed,
    Seconds,
    Share,
    Text,
    Track,
    Word,
)
from saflite.contract.flight import Ending, Flight, Purpose
from saflite.contract.names import Label, Name, NameOrNone, ShortId
from saflite.contract.score import Score, Usage
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Settings, TestCase
from saflite.contract.verdict import TRANSITIONS_MAX, Judgement, Ruling, Transition, Violation
from saflite.contract.wire import UNREADABLE, unpack

Stage = Literal["mutate", "score", "fly", "judge", "record"]
TARGETS_MAX = 256  # that one worker can fly
BEATS_PER_LEASE = 5  # a lease outlives the loss of four heartbeats in a row
Names = Annotated[tuple[Name, ...], msgspec.Meta(max_length=1_000)]
TestCases = Annotated[tuple[TestCase, ...], msgspec.Meta(max_length=ITEMS_MAX)]
GUIDANCE_NEAR, GUIDANCE_FAR = 100.0, 1000.0


class RuleOutcome(msgspec.Struct, frozen=True, array_like=True):
    """What one flight said of one policy; see `Verdict`."""

    policy: Name
    outcome: Ruling
    nearness: Share = 1.0
    robustness: Number | None = None
    applied_from_s: Number | None = None


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one flown test case: what strategies and learning scorers are told.

    `robustness` is the worst over the campaign's policies, None if none of their rules applied (or the flight said
    nothing: wedged, quarantined). `nearness` tells how near the nearest of the rules that never applied came to
    applying, 0 to 1; None where there is none. `rules` tells both policy by policy, `transitions` the steps of the
    flight through the target's states. `behaviours` are the fingerprints of the ways in which it violated, of which it
    was the first to show `founded`; `points` are those of the competition.
    """

    test_case: TestCase
    round: Place
    ending: Ending
    robustness: Number | None
    nearness: Share | None = None
    violated: Names = ()
    features: Features = {}
    track: Track = ()
    rules: Annotated[tuple[RuleOutcome, ...], msgspec.Meta(max_length=1_000)] = ()
    transitions: Annotated[tuple[Transition, ...], msgspec.Meta(max_length=TRANSITIONS_MAX)] = ()
    behaviours: Annotated[tuple[ShortId, ...], msgspec.Meta(max_length=1_000)] = ()
    founded: Count = 0
    points: Number = 0.0

    @property
    def guidance(self) -> float | None:
        """A number for searches only: the less, the closer to a violation; None where the flight said nothing.

        The robustness where a rule applied; for a rule that never applied GUIDANCE_FAR, less the nearer it came to
        applying, down to GUIDANCE_NEAR. It is no distance to anything and is never shown.
        """
        distances = [] if self.robustness is None else [self.robustness]
        if self.nearness is not None:
            distances.append(GUIDANCE_NEAR + (GUIDANCE_FAR - GUIDANCE_NEAR) * (1.0 - self.nearness))
        return min(distances, default=None)


Outcomes = Annotated[tuple[Outcome, ...], msgspec.Meta(max_length=ITEMS_MAX)]

# ---- work: what is to be done -------------------------------------------------------------------------------------


class MutateWork(msgspec.Struct, frozen=True, kw_only=True, tag="mutate"):
    """Propose `count` test cases for `round`, given the outcomes since the cursor the worker asked with.

    `target` says what can be given to the target; no strategy knows any of its own accord.
    """

    round: Count
    count: Count
    strategy: Word
    settings: Settings
    rng_seed: RngSeed
    template: TestCase
    target: TargetInfo
    policies: Names
    outcomes: Outcomes
    from_cursor: Place
    cursor: Place


class PolicyText(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A policy that does not ship: the TOML it stands in, and the file that was read, for messages."""

    file: Text
    text: Document


PolicyTexts = Annotated[dict[Word, PolicyText], msgspec.Meta(max_length=1_000)]
"""By the policy's id."""


class ScoreWork(msgspec.Struct, frozen=True, kw_only=True, tag="score"):
    """Score the test cases with `model` (this decides) and with each of `shadow` (these only watch).

    Models learn from the rounds after `since` up to `cursor`, whoever scores; `recent` holds the outcomes of those of
    them that come after `from_cursor`. A model may take `deadline_s` of wall time for an answer; then the embedded
    scorer answers in its place. `within_s` is how long simulators have work yet, shared among the batches that wait:
    what a slow model does not answer by then the embedded scorer decides; None: no matter how long it takes.
    """

    round: Count
    model: Label
    shadow: Annotated[tuple[Label, ...], msgspec.Meta(max_length=100)]
    policies: Names
    policy_texts: PolicyTexts = {}
    test_cases: TestCases
    rng_seed: RngSeed
    recent: Outcomes = ()
    since: Place = -1
    from_cursor: Place = -1
    cursor: Place = -1
    deadline_s: Seconds = 60.0
    within_s: Seconds | None = None


class WarmWork(msgspec.Struct, frozen=True, kw_only=True, tag="warm"):
    """Load `model` and answer one probe, so that a swap costs no batch; loading may take `load_deadline_s`."""

    model: Label
    load_deadline_s: Seconds = 300.0


class FlyWork(msgspec.Struct, frozen=True, kw_only=True, tag="fly"):
    """Fly the test case once, under the `noise`-th random seed (`under_noise`; 0 is its own).

    The flight bears the identity of the test case under whatever noise. `wall_limit_s` is the wall-clock deadline
    after which it counts as wedged. Nothing after `until_s` of simulated time is asked for; None: to its end.
    """

    test_case: TestCase
    flight_index: Count
    purpose: Purpose
    wall_limit_s: Seconds
    noise: Count = 0
    until_s: Seconds | None = None


class JudgeWork(msgspec.Struct, frozen=True, kw_only=True, tag="judge"):
    """Judge the flight against the policies. Its trace is the blob that `flight.trace` names."""

    test_case: TestCase
    flight: Flight
    policies: Names
    policy_texts: PolicyTexts = {}


class RecordWork(msgspec.Struct, frozen=True, kw_only=True, tag="record"):
    """Make the recording of one flight. Its trace is the blob that `flight.trace` names."""

    test_case: TestCase
    flight: Flight
    judgement: Judgement
    violation: Violation | None = None
    scores: Annotated[tuple[Score, ...], msgspec.Meta(max_length=ITEMS_MAX)] = ()
    policy_texts: PolicyTexts = {}


Work = MutateWork | ScoreWork | WarmWork | FlyWork | JudgeWork | RecordWork


# ---- results: what was done ---------------------------------------------------------------------------------------


class MutateResult(msgspec.Struct, frozen=True, kw_only=True, tag="mutated"):
    """The test cases proposed for `round`, in order."""

    round: Count
    test_cases: TestCases


class ScoreResult(msgspec.Struct, frozen=True, kw_only=True, tag="scored"):
    """One deciding score per test case asked, shadow scores besides, and what the calls took per model."""

    scores: Annotated[tuple[Score, ...], msgspec.Meta(max_length=ITEMS_MAX)]
    usage: Annotated[dict[Word, Usage], msgspec.Meta(max_length=1_000)] = {}


class WarmResult(msgspec.Struct, frozen=True, kw_only=True, tag="warmed"):
    """Whether the model answered its probe."""

    model: Label
    ready: bool
    message: Text = ""


class FlyResult(msgspec.Struct, frozen=True, kw_only=True, tag="flown"):
    """The flight; the blobs it names were left where the books can read them."""

    flight: Flight


class JudgeResult(msgspec.Struct, frozen=True, kw_only=True, tag="judged"):
    """The verdicts on one flight."""

    judgement: Judgement


class RecordResult(msgspec.Struct, frozen=True, kw_only=True, tag="recorded"):
    """The recording of a flight, left as a blob where the books can read it."""

    test_case: ShortId
    flight_index: Count
    blob: BlobRef


class Failure(msgspec.Struct, frozen=True, kw_only=True, tag="failed"):
    """The worker could not do the work; it is leased again, elsewhere if possible, and counted.

    `unread` names blobs the work needs that were not there, or damaged.
    """

    message: Text
    unread: Annotated[tuple[BlobRef, ...], msgspec.Meta(max_length=BLOBS_PER_RESULT_MAX)] = ()


class HandedBack(msgspec.Struct, frozen=True, kw_only=True, tag="handed_back"):
    """The worker gives the lease back untouched (it is stopping); leased again at once, counted as no attempt."""

    message: Text = ""


Result = MutateResult | ScoreResult | WarmResult | FlyResult | JudgeResult | RecordResult | Failure | HandedBack


def blobs_left(result: Result) -> tuple[BlobRef, ...]:
    """Return the blobs a result names as left behind."""
    if isinstance(result, FlyResult):
        return result.flight.blobs
    return (result.blob,) if isinstance(result, RecordResult) else ()


LeaseId = Word

# ---- the conversation ---------------------------------------------------------------------------------------------


class TargetBuild(msgspec.Struct, frozen=True, order=True):
    """A target and the digest of the build of it (`TargetInfo.build`); an empty digest: not known, or any will do."""

    name: Word
    build: Word = ""


class Ask(msgspec.Struct, frozen=True, kw_only=True):
    """A worker that has joined asks for work.

    `cursor` is the round up to which a mutator or learning scorer has been told outcomes; `targets` are those a
    simulator worker can fly, empty for whatever comes.
    """

    worker: Name
    stage: Stage
    session: NameOrNone = ""
    leases_max: Count = 1
    wait_s: Number = 5.0
    cursor: Place = -1
    targets: Annotated[tuple[TargetBuild, ...], msgspec.Meta(max_length=TARGETS_MAX)] = ()


class Lease(msgspec.Struct, frozen=True, kw_only=True):
    """Leave to do `work` until `lease_s` after the last heartbeat; no longer than `overdue_s` in all (0: not told)."""

    lease_id: LeaseId
    epoch: Count
    lease_s: Seconds
    work: Work
    overdue_s: Seconds = 0.0


class Grant(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to `Ask`: leases, or an explicit nothing with the time after which to ask again.

    `refused` says in words why this worker is given nothing until it has joined (again).
    """

    leases: Annotated[tuple[Lease, ...], msgspec.Meta(max_length=1_000)] = ()
    retry_after_s: Seconds = 0.5
    stop: bool = False
    refused: Account = ""


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """A result, kept by the worker until a receipt for it arrives.

    `ask` is the worker's next question for work, of the same worker and stage: it spares both sides a message.
    """

    worker: Name
    lease_id: LeaseId
    epoch: Count
    result: Result
    ask: Ask | None = None


class LeaseNamed(msgspec.Struct, frozen=True, kw_only=True):
    """A report without its result: enough to know which attempt went wrong where the result cannot be read."""

    worker: Name
    lease_id: LeaseId
    epoch: Count


def lease_named(report: bytes) -> LeaseNamed | None:
    """Return the lease an encoded report is for, None if that cannot be read either."""
    try:
        return unpack(report, LeaseNamed)
    except UNREADABLE:
        return None


ReceiptStatus = Literal["accepted", "duplicate", "stale", "refused"]


class Receipt(msgspec.Struct, frozen=True, kw_only=True):
    """Sent after the books have committed. Whatever the status, the worker may now forget the result.

    `grant` answers the question that came with it, at once: who was given nothing asks anew, and then waits.
    """

    lease_id: LeaseId
    epoch: Count
    status: ReceiptStatus
    message: Account = ""
    grant: Grant | None = None


class Heartbeat(msgspec.Struct, frozen=True, kw_only=True):
    """Extends the leases named and says how the worker is."""

    worker: Name
    stage: Stage
    session: NameOrNone = ""
    leases: Annotated[tuple[tuple[LeaseId, Count], ...], msgspec.Meta(max_length=1_000)] = ()
    state: Literal["idle", "busy", "draining"] = "idle"
    busy_s: Seconds = 0.0
    idle_s: Seconds = 0.0
    done: Count = 0
    simulated_s: Seconds = 0.0
    resident_mib: Quantity = 0.0
    processor_s: Seconds = 0.0


class Orders(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to a heartbeat: leases to drop, whether to stop, why the worker has to join (again).

    The next heartbeats may be `beat_s` apart, where the leases held let them.
    """

    cancel: Annotated[tuple[LeaseId, ...], msgspec.Meta(max_length=1_000)] = ()
    stop: bool = False
    refused: Account = ""
    beat_s: Seconds = 0.0
