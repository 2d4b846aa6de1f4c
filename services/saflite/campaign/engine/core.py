"""What all parts of the books share: the table of work, the rounds, the counts, and the way out."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

from saflite.campaign.engine.exposure import ArmCounts, Exposure
from saflite.campaign.engine.outbox import Outbox
from saflite.campaign.lifecycle.confirmation import Trial
from saflite.campaign.lifecycle.repeats import RepeatRule
from saflite.campaign.scheduling.rounds import Rounds
from saflite.campaign.scheduling.tasks import Task, TaskTable
from saflite.campaign.scheduling.work_keys import FlightKey, RecordKey
from saflite.contract.blobs import BlobRef
from saflite.contract.config import Campaign
from saflite.contract.events import CampaignChanged, Fact, FaultSeen, WorkerChanged
from saflite.contract.flight import FLOWN_ENDINGS, Flight, Purpose
from saflite.contract.score import Score
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement, Violation
from saflite.flight.novelty import REFERENCES_MAX, Features

State = Literal["running", "paused", "ended"]
MEMBERS_MAX = 2_000  # as many workers as there may be, and those of the sitting before


@dataclass(slots=True)
class Counts:
    """Exact counts of the campaign. `flights` are first flights: they alone count against the budget."""

    flights: int = 0
    reflown: int = 0  # to confirm violations
    checked: int = 0  # first flights flown over again, to see that the farm repeats them
    shrink_flights: int = 0
    selected: int = 0
    ended: int = 0
    candidates: int = 0
    behaviours: int = 0  # ways to violate that a find has confirmed
    confirmed: int = 0
    similar: int = 0  # finds of behaviours that another has confirmed
    flaky: int = 0
    unconfirmed: int = 0
    quarantined: int = 0
    unequal: int = 0  # flights flown over again that were no repeat on a target that says it repeats bit by bit
    scores: Counter[str] = field(default_factory=Counter)  # that decided, by the model that was to give them
    scores_by_model: Counter[str] = field(default_factory=Counter)  # of them those it gave, and no other in its place
    fallbacks: int = 0  # scores that the model asked did not give
    unscored: int = 0  # of them those that nobody gave
    fallback_why: str = ""  # what the scorer said last
    simulated_s: float = 0.0
    wall_s: float = 0.0
    last_find_s: float | None = None  # campaign time of the last new violation


@dataclass(slots=True)
class RecordingParts:
    """What a recording is made of, kept until it is written."""

    test_case: TestCase
    flight: Flight
    judgement: Judgement
    violation: Violation | None
    scores: tuple[Score, ...]


@dataclass(slots=True)
class Hold:
    """A blob that is needed: how large it is, and by how many flights and recordings."""

    size_bytes: int
    times: int = 0


@dataclass(slots=True)
class Core:
    """The shared state of the fold. `at_s` is the moment of the entry being applied."""

    campaign: Campaign
    template: TestCase
    target: TargetInfo
    out: Outbox
    rounds: Rounds
    confirm: RepeatRule
    tasks: TaskTable = field(default_factory=TaskTable)
    counts: Counts = field(default_factory=Counts)
    exposure: Exposure = field(default_factory=Exposure)
    arms: dict[str, ArmCounts] = field(default_factory=dict)  # of a portfolio
    trials: dict[str, Trial] = field(default_factory=dict)  # of test cases that a round selected
    forms: dict[str, Trial] = field(default_factory=dict)  # of smallest forms; one may be a test case above as well
    records: dict[RecordKey, RecordingParts] = field(default_factory=dict)
    flown: dict[str, int] = field(default_factory=dict)  # every test case ever selected: its round
    shrunk: set[str] = field(default_factory=set)  # smallest forms of violations, flown besides
    latest: deque[Features] = field(default_factory=lambda: deque(maxlen=REFERENCES_MAX))
    promised: dict[str, float] = field(default_factory=dict)  # finds that the flights chosen promise, by kind
    holds: dict[str, Hold] = field(default_factory=dict)  # by digest, as the store does: peers may claim any size
    full: bool = False  # as much is kept as the campaign allows
    members: dict[str, str] = field(default_factory=dict)  # workers that joined and have not left: by which key
    state: State = "running"
    failed: str = ""  # why the strategy is asked no more; what was chosen before is flown to its end
    stopped: bool = False  # ended by an operator, so opening the books again goes on
    incarnation: int = 0
    at_s: float = 0.0
    opened_s: float = 0.0
    elapsed_before_s: float = 0.0

    def note_member(self, change: WorkerChanged, key: str | None) -> None:
        """Note who has come or left; of those who never said that they left, the oldest are forgotten."""
        self.members.pop(change.worker, None)
        if change.present and key is not None:
            self.members[change.worker] = key
        if len(self.members) > MEMBERS_MAX:
            del self.members[next(iter(self.members))]

    def elapsed_s(self, now_s: float) -> float:
        """Return the time the books have been open, over all incarnations."""
        return self.elapsed_before_s + max(0.0, now_s - self.opened_s)

    @property
    def is_searching(self) -> bool:
        """Whether a round is under way, other than the one that a strategy which failed proposes nothing for."""
        return len(self.rounds.under_way) > bool(self.failed)

    def trial_of(self, key: FlightKey | RecordKey) -> Trial:
        """Return the trial that a flight belongs to."""
        return (self.forms if key.purpose == "shrunk" else self.trials)[key.test_case]

    def all_trials(self) -> Iterator[Trial]:
        """Yield every trial under way."""
        yield from self.trials.values()
        yield from self.forms.values()

    def was_flown(self, name: str) -> bool:
        """Whether a test case was ever selected, or flown as the smallest form of a violation.

        For smallest forms only: when one was flown depends on timing, so the choice of the search must not heed it.
        """
        return name in self.flown or name in self.shrunk

    def stands(self, trial: Trial) -> bool:
        """Whether what a trial shows is what is said of its test case: of one that a round selected, that trial alone.

        So a smallest form tells nothing more once the search has chosen the very same test case, and whatever was told
        before is replaced: what is known in the end does not depend on which of the two was flown first.
        """
        return trial.is_selected or trial.name not in self.flown

    def tell(self, fact: Fact) -> None:
        """Announce a fact."""
        self.out.fact(fact, self.at_s)

    def fault(self, where: str, message: str) -> None:
        """Announce that the farm got over something."""
        self.tell(FaultSeen(where=where, message=message))

    def change_state(self, state: State, why: str, *, failed: bool = False) -> None:
        """Begin, pause, resume or end the campaign; `failed`: it ends because a part of it broke."""
        if state != self.state:
            self.state = state
            self.tell(CampaignChanged(state=state, why=why, failed=failed))

    def done(self, task: Task, how: str, message: str = "") -> None:
        """Take out a task that is done or given up, and write down its last attempt."""
        self.attempt_over(task, how, message)
        self.tasks.remove(task.key)

    def attempt_over(self, task: Task, how: str, message: str = "") -> None:
        """Write down how the attempt at hand ended."""
        if not task.waiting:
            unix_s = self.out.unix_s(task.granted_s), self.out.unix_s(self.at_s)
            self.out.row("attempts", str(task.key), task.epoch, task.stage, task.worker, *unix_s, how, message)

    def again(self, task: Task, how: str, message: str) -> None:
        """Let work wait for another attempt, elsewhere if possible."""
        self.attempt_over(task, how, message)
        task.message = message or task.message
        if task.worker and how != "handed_back":
            task.avoid |= {task.worker}
        self.tasks.requeue(task)

    def note_flight(self, flight: Flight, purpose: Purpose) -> None:
        """Write a flight down, the line its record stands in if a worker handed one in, and what it left behind."""
        key, trace = (flight.test_case, purpose, flight.flight_index), flight.trace
        blob = ("", 0) if trace is None else (trace.digest, trace.size_bytes)
        line = self.out.line_count if flight.ending in FLOWN_ENDINGS else None
        numbers = (flight.simulated_s, flight.wall_s, flight.trace_digest, *blob)
        self.out.row("flights", *key, flight.ending, *numbers, flight.worker, flight.message, flight.build, line)
        for artefact in flight.artefacts:
            self.out.row("artefacts", *key, artefact.name, artefact.blob.digest, artefact.blob.size_bytes)

    def hold(self, *blobs: BlobRef) -> None:
        """Note that blobs are needed once more."""
        for blob in blobs:
            self.holds.setdefault(blob.digest, Hold(blob.size_bytes)).times += 1
            self.out.keep_blob(blob.digest)

    def let_go(self, *blobs: BlobRef) -> None:
        """Note that blobs are needed once less; drop each with the last need of it."""
        for blob in blobs:
            hold = self.holds[blob.digest]
            hold.times -= 1
            if not hold.times:
                self.drop(blob.digest)

    def drop(self, digest: str) -> None:
        """Note that a blob is not needed, whoever needed it."""
        self.holds.pop(digest, None)
        self.out.drop_blob(digest)

    def flush(self, *blobs: BlobRef) -> None:
        """Have those of the blobs that are still needed safe on disk: they are kept for good."""
        for blob in blobs:
            if blob.digest in self.holds:
                self.out.flush_blob(blob.digest)
