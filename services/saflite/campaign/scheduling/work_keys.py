"""Names of pieces of work: what is to be done, told apart from everything else ever to be done in a campaign.

Keys stand in the journal, the task table and the leases as they are. As text they go to people, into the `attempts`
table and into lease ids; `str` of a key is the only place that makes such text and `read_key` the only one that reads
it back, when a worker returns a lease id.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import ClassVar, get_args

import msgspec

from saflite.contract import wire
from saflite.contract.flight import Purpose
from saflite.contract.work import Stage


class _Key(msgspec.Struct, frozen=True, order=True, array_like=True):
    """Fields are numbers, words and identities; only the last one may hold a slash."""

    stage: ClassVar[Stage]

    def __str__(self) -> str:
        return _form(type(self)) % msgspec.structs.astuple(self)


@cache
def _form(kind: type[_Key]) -> str:
    return "/".join((str(kind.__struct_config__.tag), *("%s" for _ in kind.__struct_fields__)))


class MutateKey(_Key, frozen=True, order=True, array_like=True, tag="mutate"):
    """Propose the test cases of a round."""

    stage: ClassVar[Stage] = "mutate"
    round: int


class ScoreKey(_Key, frozen=True, order=True, array_like=True, tag="score"):
    """Score one batch of a round."""

    stage: ClassVar[Stage] = "score"
    round: int
    batch: int


class WarmKey(_Key, frozen=True, order=True, array_like=True, tag="warm"):
    """Load a model for the `swap`-th change of models."""

    stage: ClassVar[Stage] = "score"
    swap: int
    model: str


class FlyKey(_Key, frozen=True, order=True, array_like=True, tag="fly"):
    """Fly a test case. Flights of one purpose are numbered from 0, re-flights of a search flight from 1."""

    stage: ClassVar[Stage] = "fly"
    test_case: str
    purpose: Purpose
    index: int

    @property
    def judging(self) -> JudgeKey:
        """The judging of this flight."""
        return JudgeKey(self.test_case, self.purpose, self.index)


class JudgeKey(_Key, frozen=True, order=True, array_like=True, tag="judge"):
    """Judge one flight."""

    stage: ClassVar[Stage] = "judge"
    test_case: str
    purpose: Purpose
    index: int

    @property
    def flying(self) -> FlyKey:
        """The flight that is judged."""
        return FlyKey(self.test_case, self.purpose, self.index)


class RecordKey(_Key, frozen=True, order=True, array_like=True, tag="record"):
    """Write the recording of one flight."""

    stage: ClassVar[Stage] = "record"
    test_case: str
    purpose: Purpose
    index: int


FlightKey = FlyKey | JudgeKey
WorkKey = MutateKey | ScoreKey | WarmKey | FlyKey | JudgeKey | RecordKey

_KINDS: dict[str, type[WorkKey]] = {str(kind.__struct_config__.tag): kind for kind in get_args(WorkKey)}


@lru_cache(maxsize=8_192)  # a key is read again with each heartbeat that names its lease, and with the result
def read_key(text: str) -> WorkKey | None:
    """Return the key that has this text, None if no key has."""
    tag, _, rest = text.partition("/")
    kind = _KINDS.get(tag)
    if kind is None:
        return None
    values = rest.split("/", len(kind.__struct_fields__) - 1)
    try:
        key = wire.convert((tag, *values), kind, strict=False)
    except msgspec.ValidationError:
        return None
    return key if str(key) == text else None


def run_and_key(lease_id: str) -> tuple[str, WorkKey | None]:
    """Return the run a lease is of and what it is a lease to do, None if that is no work of any campaign."""
    run_id, _, text = lease_id.partition(":")
    return run_id, read_key(text)
