"""What an operator may ask of a running campaign, and the answer."""

from __future__ import annotations

from typing import Literal

import msgspec

from saflite.contract.bounds import Count, Text

Verb = Literal["pause", "resume", "stop", "budget", "scorer", "shadow", "status", "events"]


class Control(msgspec.Struct, frozen=True, kw_only=True):
    """An order. `text` holds the scorer model, `number` the new budget or the sequence number to send from."""

    verb: Verb
    text: Text = ""
    number: Count = 0


class WorkerStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One worker as the books see it."""

    worker: str
    stage: str
    state: str
    leases: int
    done: int
    busy_share: float
    silent_s: float
    resident_mib: float = 0.0
    host: str = ""
    build: str = ""
    cores: int = 0
    labels: dict[str, str] = {}


class Exposed(msgspec.Struct, frozen=True, kw_only=True):
    """What the flights put to the test: policies whose rule ever applied, the share of verdicts in which it did.

    `silent` names the policies that never applied; `states` and `steps` count the target's states seen, and the
    different (state, next state, kind of input, kind of the one before).
    """

    spoke: int = 0
    silent: tuple[str, ...] = ()
    applied_share: float = 0.0
    states: int = 0
    steps: int = 0


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """The campaign at a glance. All counts are exact; rates are over the last minute.

    `processor_s` is the processor time of the books and all workers with their simulators in this sitting.

    `flights` are first flights, which alone count against `budget`; beside them are those `reflown` to confirm,
    `checked` for repeating bit by bit (`unequal` did not), and flown to make violations smaller. `trouble`, if there is
    any: why nothing is taken or handed out just now, such as a full disk.
    """

    campaign: str
    state: str
    round: int
    budget: int
    flights: int
    reflown: int
    checked: int = 0
    shrink_flights: int = 0
    test_cases: int
    candidates: int
    behaviours: int = 0
    violations_confirmed: int
    violations_similar: int = 0
    violations_flaky: int
    violations_pending: int
    quarantined: int
    unequal: int = 0
    flights_per_s: float
    real_time_factor: float
    processor_s: float = 0.0
    since_last_find_s: float | None
    elapsed_s: float
    scorer: str
    scorer_pending: str
    fallbacks: int
    queues: dict[str, int]
    workers: tuple[WorkerStatus, ...]
    seq: int
    exposure: Exposed = Exposed()
    trouble: Text = ""

    @property
    def behaviours_per_core_minute(self) -> float | None:
        """New behaviours per minute of processor time; None before any was told of."""
        return 60.0 * self.behaviours / self.processor_s if self.processor_s else None


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to a control order. `events` holds encoded `Event`s for `events`."""

    accepted: bool
    message: str = ""
    status: Status | None = None
    events: tuple[bytes, ...] = ()
