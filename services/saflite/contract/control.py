"""What an operator may ask of a running campaign, and the answer."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from saflite.contract.bounds import ITEMS_MAX, Account, Count, Labels, Place, Quantity, Share, Text, Word
from saflite.contract.events import Event
from saflite.contract.names import Name

NOT_RUNNING = "not running"
"""What people are told of a campaign that has not ended, and on which no farm works."""

Verb = Literal["pause", "resume", "stop", "budget", "scorer", "shadow", "status", "events"]


class Control(msgspec.Struct, frozen=True, kw_only=True):
    """An order. `text` holds the scorer model, `number` the new budget or the sequence number to send from."""

    verb: Verb
    text: Text = ""
    number: Count = 0


class WorkerStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One worker as the books see it."""

    worker: Word
    stage: Word
    state: Word
    leases: Count
    done: Count
    busy_share: Share
    silent_s: Quantity
    resident_mib: Quantity = 0.0
    host: Word = ""
    build: Word = ""
    cores: Count = 0
    labels: Labels = {}


class Exposed(msgspec.Struct, frozen=True, kw_only=True):
    """What the flights put to the test: policies whose rule ever applied, the share of verdicts in which it did.

    `silent` names the policies that never applied; `states` and `steps` count the target's states seen, and the
    different (state, next state, kind of input, kind of the one before).
    """

    spoke: Count = 0
    silent: Annotated[tuple[Name, ...], msgspec.Meta(max_length=1_000)] = ()
    applied_share: Share = 0.0
    states: Count = 0
    steps: Count = 0


class ArmStanding(msgspec.Struct, frozen=True, kw_only=True):
    """What an arm of a portfolio had flown, and the behaviours its test cases were the first to show."""

    arm: Word
    flights: Count
    founded: Count


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """The campaign at a glance. All counts are exact; rates are over the last minute.

    `processor_s` is the processor time of the books and all workers with their simulators in this sitting, the last of
    `sittings`: a run that is taken up again has one more.

    `flights` are first flights, which alone count against `budget`; beside them are those `reflown` to confirm,
    `checked` for repeating bit by bit (`unequal` did not), and flown to make violations smaller. `scores` are those
    that `scorer` was to give in all, `scores_by_model` of them those it gave itself; what scorers before it were to
    give is in neither. `trouble`, if there is any: why nothing is taken or handed out just now, such as a full disk.
    """

    campaign: Word
    state: Word
    round: Place
    budget: Count
    flights: Count
    reflown: Count
    checked: Count = 0
    shrink_flights: Count = 0
    test_cases: Count
    candidates: Count
    behaviours: Count = 0
    violations_confirmed: Count
    violations_similar: Count = 0
    violations_flaky: Count
    violations_pending: Count
    quarantined: Count
    unequal: Count = 0
    flights_per_s: Quantity
    real_time_factor: Quantity
    processor_s: Quantity = 0.0
    sittings: Count = 1
    since_last_find_s: Quantity | None
    elapsed_s: Quantity
    scorer: Word
    scorer_pending: Word
    fallbacks: Count
    unscored: Count = 0
    fallback_why: Text = ""
    scores: Count = 0
    scores_by_model: Count = 0
    queues: Annotated[dict[Word, Count], msgspec.Meta(max_length=100)]
    workers: Annotated[tuple[WorkerStatus, ...], msgspec.Meta(max_length=ITEMS_MAX)]
    seq: Count
    exposure: Exposed = Exposed()
    arms: Annotated[tuple[ArmStanding, ...], msgspec.Meta(max_length=ITEMS_MAX)] = ()
    trouble: Text = ""

    @property
    def behaviours_per_core_minute(self) -> float | None:
        """New behaviours per minute of processor time; None before any was told of, or after earlier sittings."""
        return 60.0 * self.behaviours / self.processor_s if self.processor_s and self.sittings == 1 else None


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to a control order. `events` holds encoded `Event`s for `events`."""

    accepted: bool
    message: Account = ""
    status: Status | None = None
    events: Annotated[tuple[bytes, ...], msgspec.Meta(max_length=ITEMS_MAX)] = ()


class AnswerJson(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to an order that was given in JSON, in JSON."""

    accepted: bool
    message: Account = ""
    status: Status | None = None
    events: Annotated[tuple[Event, ...], msgspec.Meta(max_length=ITEMS_MAX)] = ()
