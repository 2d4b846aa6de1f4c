"""The mutate stage: outcomes in, test cases out. A restart asks from zero and is told everything again."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import msgspec

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.outside_code import Raised, of_outside
from saflite.contract.rng import derive
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Stimulus, TestCase
from saflite.contract.work import HandedBack, MutateResult, MutateWork, Result, Stage, Work
from saflite.mutator.registry import is_outside, load_strategy
from saflite.mutator.strategy import Strategy

NOTHING_TOLD = -1


class Mutator:
    """One mutator. `cursor` is the round up to which its strategy was told outcomes."""

    stage: Stage = "mutate"
    parallel = 1

    def __init__(self) -> None:
        self._strategy: Strategy | None = None
        self._made_of: bytes = b""
        self._cursor = NOTHING_TOLD

    @property
    def cursor(self) -> int:
        """The round up to which outcomes were told; -1 for none."""
        return self._cursor

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Propose the test cases of one round.

        Raises:
            Raised: a strategy from outside raised what is no error of its kind.
            Refused: unknown strategy, bad settings, a template the strategy cannot mutate, or a number that is none.
            Unavailable: the outcomes told do not join on to those known; ask again, the cursor is back at the start.
        """
        assert isinstance(work, MutateWork), f"the mutator was given {type(work).__name__}"
        try:
            with of_outside("strategy", work.strategy, outside=is_outside(work.strategy)):
                strategy = self._told(work)
                proposed = _numbered(work, strategy.ask(work.count, derive(work.rng_seed, "mutate", work.round)))
                _check_numbers(proposed)
        except Raised:
            self._forget()  # what it had learnt may be half of it
            raise
        return HandedBack(message="cancelled") if cancelled() else MutateResult(round=work.round, test_cases=proposed)

    def close(self) -> None:
        """Forget everything."""
        self._forget()

    def _forget(self) -> None:
        self._strategy, self._cursor = None, NOTHING_TOLD

    def _told(self, work: MutateWork) -> Strategy:
        """Return the strategy after it was told the outcomes up to `work.cursor`, no more and no fewer."""
        # without rng_seed, a new one every round
        parts = (work.strategy, work.settings, work.template, work.policies, work.target)
        made_of = msgspec.msgpack.encode(parts, order="deterministic")
        if work.from_cursor == NOTHING_TOLD or made_of != self._made_of:
            self._forget()
        if work.from_cursor != self._cursor or work.cursor < self._cursor:
            known, self._made_of = self._cursor, b""
            self._forget()
            raise Unavailable(f"outcomes {work.from_cursor}..{work.cursor} do not join on to {known}")
        if self._strategy is None:
            self._strategy = load_strategy(work.strategy)(
                work.template, dict(work.settings), work.policies, work.target
            )
            self._made_of = made_of
        self._strategy.tell(work.outcomes)
        self._cursor = work.cursor
        return self._strategy


def _numbered(work: MutateWork, proposed: Sequence[TestCase]) -> tuple[TestCase, ...]:
    return tuple(
        msgspec.structs.replace(
            case, origin=msgspec.structs.replace(case.origin, strategy=work.strategy, round=work.round, index=index)
        )
        for index, case in enumerate(proposed)
    )


def _check_numbers(proposed: Sequence[TestCase]) -> None:
    """Raise Refused for a number that is none or has no end, saying where it stands: the wire would not say."""
    for index, case in enumerate(proposed):
        for place, value in _endless(case, ""):
            raise Refused(f"test case {index} of the strategy", where=place, expected="a finite number", got=value)


def _endless(value: object, place: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a part of a test case that are not finite, and where they stand."""
    if isinstance(value, float) and not math.isfinite(value):
        yield place, value
    elif isinstance(value, msgspec.Struct):
        named = f"{place} ({value.kind} {value.name})" if isinstance(value, Stimulus) else place
        for name in value.__struct_fields__:
            yield from _endless(getattr(value, name), f"{named}.{name}".removeprefix("."))
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from _endless(part, f"{place}.{key}")
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from _endless(part, f"{place}[{number}]")


def open_service() -> Mutator:
    """Return the mutate stage for the worker loop."""
    return Mutator()
