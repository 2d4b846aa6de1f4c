"""What a scorer model says of a test case before it is flown."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from saflite.contract.bounds import Count, Number, Quantity, Seconds, Text, Word
from saflite.contract.names import Label, ShortId

SCORE_MIN, SCORE_MAX = 0.0, 10.0
DULL_BELOW, INTERESTING_ABOVE = 4.0, 7.0  # bands of the paper (section IV-C); 4..7 is middling

EMBEDDED = "blend"
"""The scorer that answers in the place of one that cannot; it needs no server and nothing from outside."""

UNSCORED = "none"
"""Stands for the scorer of a test case that nobody scored, not even the embedded one: its processes were lost."""

Band = Literal["dull", "middling", "interesting"]


class Usage(msgspec.Struct, frozen=True, kw_only=True):
    """What a model's calls for one batch took. `cost_usd` stays 0 where no price is set.

    `asked_again` counts questions put a second time, `cached` answers taken from the cache, `faults` the answers that
    could not be used, by name.
    """

    tokens_in: Count = 0
    tokens_out: Count = 0
    latency_s: Seconds = 0.0
    cost_usd: Quantity = 0.0
    calls: Count = 0
    asked_again: Count = 0
    cached: Count = 0
    faults: Annotated[dict[Word, Count], msgspec.Meta(max_length=1_000)] = {}


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """How likely a test case is to break the policy, 0 (dull) to 10.

    `model` is the label asked for, `scored_by` the one that answered: they differ when a fault made the embedded
    scorer step in, and `fault` then names it (`deadline`, `unreachable`, `schema`, `wrong-ids`, ...). `kind` names the
    behaviour that is expected, in the model's own words, empty where none in particular is: one more of a kind is worth
    the less, the more finds of it are to be expected already.
    """

    test_case: ShortId
    value: Number
    model: Label
    scored_by: Label
    model_digest: Word = ""
    prompt_digest: Word = ""
    reason: Text = ""
    fault: Word = ""
    kind: Word = ""
    shadow: bool = False


def band(value: float) -> Band:
    """Return the paper's band of a score: below 4 dull, 4 to 7 middling, above 7 interesting."""
    if value < DULL_BELOW:
        return "dull"
    return "interesting" if value > INTERESTING_ABOVE else "middling"
