"""Facts the books announce after they have committed them. `seq` has no gaps; any stretch can be sent again."""

from __future__ import annotations

from typing import Literal

import msgspec

from saflite.contract.flight import Ending, Purpose
from saflite.contract.verdict import Violation


class CampaignChanged(msgspec.Struct, frozen=True, kw_only=True, tag="campaign"):
    """The campaign started, paused, resumed, or ended (`why`)."""

    state: Literal["running", "paused", "ended"]
    why: str = ""


class Proposed(msgspec.Struct, frozen=True, kw_only=True, tag="proposed"):
    """A round of test cases was proposed."""

    round: int
    test_cases: tuple[str, ...]


class Scored(msgspec.Struct, frozen=True, kw_only=True, tag="scored"):
    """A batch was scored; `scores` pairs test case and value in order."""

    round: int
    model: str
    scores: tuple[tuple[str, float], ...]
    fallbacks: int = 0
    latency_s: float = 0.0


class Flown(msgspec.Struct, frozen=True, kw_only=True, tag="flown"):
    """One flight ended; those that only try smaller test cases are not announced."""

    test_case: str
    flight_index: int
    ending: Ending
    simulated_s: float
    wall_s: float
    worker: str
    purpose: Purpose = "search"
    build: str = ""


class Judged(msgspec.Struct, frozen=True, kw_only=True, tag="judged"):
    """One flight was judged; `robustness` is the worst over the policies, None if no rule applied.

    `vacuous` names the policies whose rule never applied; those neither there nor violated held or could not be judged.
    """

    test_case: str
    flight_index: int
    robustness: float | None
    violated: tuple[str, ...]
    vacuous: tuple[str, ...] = ()


class ViolationFound(msgspec.Struct, frozen=True, kw_only=True, tag="violation"):
    """A violation was decided upon: confirmed, flaky, or unconfirmed for want of budget."""

    violation: Violation


class Quarantined(msgspec.Struct, frozen=True, kw_only=True, tag="quarantined"):
    """A test case was set aside after too many lost or wedged attempts: a finding candidate."""

    test_case: str
    attempts: int
    last: Ending
    message: str = ""


class ScorerChanged(msgspec.Struct, frozen=True, kw_only=True, tag="scorer"):
    """The deciding model changed, or a change was rolled back (`ready` false)."""

    model: str
    previous: str
    ready: bool
    message: str = ""


class WorkerChanged(msgspec.Struct, frozen=True, kw_only=True, tag="worker"):
    """A worker joined or left; `build` is that of the campaign's target, of a worker that flies."""

    worker: str
    stage: str
    present: bool
    host: str = ""
    build: str = ""
    message: str = ""


class FaultSeen(msgspec.Struct, frozen=True, kw_only=True, tag="fault"):
    """Something went wrong that the farm got over: an undecodable message, a lost lease, a failed scorer."""

    where: str
    message: str


Fact = (
    CampaignChanged
    | Proposed
    | Scored
    | Flown
    | Judged
    | ViolationFound
    | Quarantined
    | ScorerChanged
    | WorkerChanged
    | FaultSeen
)


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """A fact with its place in the campaign's history."""

    seq: int
    at_unix_s: float
    fact: Fact


def kind_of(fact: Fact) -> str:
    """Return the word that stands for the fact's kind in its topic."""
    return str(type(fact).__struct_config__.tag)
