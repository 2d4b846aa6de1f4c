"""What is known of each policy before any flight: the start state its file names, and inputs that bear on it."""

from __future__ import annotations

import math
from typing import NamedTuple, get_args

from saflite.contract.errors import Refused
from saflite.contract.test_case import StartState, StimulusKind
from saflite.mutator.operators.inputs import Have, Input, named

KINDS: tuple[StimulusKind, ...] = get_args(StimulusKind)
HEIGHT_MAX_M = 1e6
START, IN, READS = "start", "in", "reads"
SHAPE = "'<policy> start:<mode>@<metres> in:<mode> reads:<kind>:<input> <kind>:<input> ...'"


class Hint(NamedTuple):
    """One policy: where its flights may begin (None: where the campaign does), its own inputs.

    `modes` are those its formula names, `read` the inputs whose values its formula reads.
    """

    policy: str
    start: StartState | None = None
    inputs: tuple[Input, ...] = ()
    modes: tuple[str, ...] = ()
    read: tuple[Input, ...] = ()

    def kinds(self) -> tuple[StimulusKind, ...]:
        """Return the kinds of its inputs, sorted."""
        return tuple(sorted({entry.kind for entry in (*self.inputs, *self.read)}))


def read_hints(texts: list[str], policies: tuple[str, ...], have: Have) -> tuple[Hint, ...]:
    """Return one hint for every policy of the campaign, an empty one where no text names it.

    Raises Refused for a text of another shape, or an input the target does not have.
    """
    read = [_read(text, have) for text in texts]
    known = {hint.policy: hint for hint in read}
    return tuple(known.get(policy, Hint(policy)) for policy in policies)


def _read(text: str, have: Have) -> Hint:
    policy, *words = text.split() or [""]
    start: StartState | None = None
    inputs: list[Input] = []
    modes: list[str] = []
    read: list[Input] = []
    for word in words:
        kind, _, name = word.partition(":")
        if kind == START:
            start = _start(name, text)
        elif kind == IN:
            modes.extend(entry.name for entry in named("mode", [name], have, "hints"))
        elif kind == READS:
            kind, _, name = name.partition(":")
            read.extend(named(_kind(kind, text), [name], have, "hints"))
        else:
            inputs.extend(named(_kind(kind, text), [name], have, "hints"))
    if not policy:
        raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))
    return Hint(policy, start, tuple(dict.fromkeys(inputs)), tuple(modes), tuple(read))


def _kind(word: str, text: str) -> StimulusKind:
    for kind in KINDS:
        if kind == word:
            return kind
    raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))


def _start(word: str, text: str) -> StartState:
    mode, _, height = word.partition("@")
    try:
        altitude_m = float(height)
    except ValueError:
        altitude_m = math.nan
    if not abs(altitude_m) <= HEIGHT_MAX_M:
        raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))
    return StartState(mode=mode, altitude_m=altitude_m)
