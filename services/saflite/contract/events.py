"""Facts the books announce after they have committed them. `seq` has no gaps; any stretch can be sent again."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec

from saflite.contract.bounds import ITEMS_MAX, Account, Count, Number, Place, Quantity, Seconds, Word
from saflite.contract.flight import Ending, Purpose
from saflite.contract.names import Label, Name, ShortId
from saflite.contract.verdict import Violation

Names = Annotated[tuple[Name, ...], msgspec.Meta(max_length=1_000)]


class CampaignChanged(msgspec.Struct, frozen=True, kw_only=True, tag="campaign", omit_defaults=True):
    """The campaign started, paused, resumed, or ended (`why`).

    `failed`: it ended before its budget was flown because a part of it broke, as a strategy that raises each time.
    """

    state: Literal["running", "paused", "ended"]
    why: Account = ""
    failed: bool = False  # left out where it is not so: events of earlier runs are the same bytes as ever


class Proposed(msgspec.Struct, frozen=True, kw_only=True, tag="proposed"):
    """A round of test cases was proposed."""

    round: Place
    test_cases: Annotated[tuple[ShortId, ...], msgspec.Meta(max_length=ITEMS_MAX)]


class Scored(msgspec.Struct, frozen=True, kw_only=True, tag="scored"):
    """A batch was scored; `scores` pairs test case and value in order.

    `fallbacks` of them the model asked did not give, `unscored` of these nobody.
    """

    round: Place
    model: Label
    scores: Annotated[tuple[tuple[ShortId, Number], ...], msgspec.Meta(max_length=ITEMS_MAX)]
    fallbacks: Count = 0
    unscored: Count = 0
    latency_s: Quantity = 0.0


class Flown(msgspec.Struct, frozen=True, kw_only=True, tag="flown"):
    """One flight ended; those that only try smaller test cases are not announced."""

    test_case: ShortId
    flight_index: Count
    ending: Ending
    simulated_s: Seconds
    wall_s: Seconds
    worker: Word
    purpose: Purpose = "search"
    build: Word = ""


class Judged(msgspec.Struct, frozen=True, kw_only=True, tag="judged"):
    """One flight was judged; `robustness` is the worst over the policies, None if no rule applied.

    `vacuous` names the policies whose rule never applied; those neither there nor violated held or could not be judged.
    """

    test_case: ShortId
    flight_index: Count
    robustness: Number | None
    violated: Names
    vacuous: Names = ()


class ViolationFound(msgspec.Struct, frozen=True, kw_only=True, tag="violation"):
    """A violation was decided upon: confirmed, flaky, or unconfirmed for want of budget."""

    violation: Violation


class Quarantined(msgspec.Struct, frozen=True, kw_only=True, tag="quarantined"):
    """A test case was set aside after too many lost or wedged attempts: a finding candidate."""

    test_case: ShortId
    attempts: Count
    last: Ending
    message: Account = ""


WATCHES_ONLY = "watches only; "
"""What is told first of a change of the models that do not decide."""


class ScorerChanged(msgspec.Struct, frozen=True, kw_only=True, tag="scorer"):
    """The deciding model, or those that only watch, changed, or a change was rolled back (`ready` false)."""

    model: Label
    previous: Label
    ready: bool
    message: Account = ""

    @property
    def decides(self) -> bool:
        """Whether it is of the model that decides."""
        return not self.message.startswith(WATCHES_ONLY)


class BudgetChanged(msgspec.Struct, frozen=True, kw_only=True, tag="budget"):
    """An operator changed how many first flights may be flown, before and now."""

    budget: Count
    previous: Count


class WorkerChanged(msgspec.Struct, frozen=True, kw_only=True, tag="worker"):
    """A worker joined or left; `build` is that of the campaign's target, of a worker that flies."""

    worker: Word
    stage: Word
    present: bool
    host: Word = ""
    build: Word = ""
    message: Account = ""


class FaultSeen(msgspec.Struct, frozen=True, kw_only=True, tag="fault"):
    """Something went wrong that the farm got over: an undecodable message, a lost lease, a failed scorer."""

    where: Word
    message: Account


Fact = (
    CampaignChanged
    | Proposed
    | Scored
    | Flown
    | Judged
    | ViolationFound
    | Quarantined
    | ScorerChanged
    | BudgetChanged
    | WorkerChanged
    | FaultSeen
)


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """A fact with its place in the campaign's history."""

    seq: Count
    at_unix_s: Number
    fact: Fact


def word_of(kind: type[msgspec.Struct]) -> str:
    """Return the word that stands for a kind of fact."""
    return str(kind.__struct_config__.tag)


KINDS = tuple(word_of(kind) for kind in get_args(Fact))
"""Of every kind of fact the word that stands for it."""


def kind_of(fact: Fact) -> str:
    """Return the word that stands for the fact's kind in its topic."""
    return word_of(type(fact))
