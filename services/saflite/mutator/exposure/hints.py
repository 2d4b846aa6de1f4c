"""What is known of each policy before any flight: the start state its file names, and inputs that bear on it."""

from __future__ import annotations

import math
from typing import NamedTuple, get_args

from saflite.contract.errors import Refused
from saflite.contract.test_case import StartState, StimulusKind
from saflite.mutator.operators.inputs import Have, Input, named

KINDS: tuple[StimulusKind, ...] = get_args(StimulusKind)
HEIGHT_MAX_M = 1e6
QUIET_MAX_S = 3600.0
START, IN, READS, MISSION, RAISED, QUIET = "start", "in", "reads", "mission", "raised", "quiet"
ASKS, HOLDS = "asks", "holds"
DISARMED = "disarmed"
SHAPE = (
    "'<policy> start:<mode>@<metres>[:disarmed] mission: in:<mode> raised:<failsafe> quiet:<seconds> "
    "asks:<parameter>=<value> holds:<stick>=<value> reads:<kind>:<input> <kind>:<input> ...'"
)


class Hint(NamedTuple):
    """One policy: where its flights may begin (None: where the campaign does), its own inputs.

    `modes` are those its formula names, `raised` the failsafes, `asked` settings with the values it compares them to,
    `held` sticks with values at which it asks them to stay, `read` the inputs whose values it reads; its state must
    last `quiet_s`; `flies_mission` if all is about missions.
    """

    policy: str
    start: StartState | None = None
    inputs: tuple[Input, ...] = ()
    modes: tuple[str, ...] = ()
    read: tuple[Input, ...] = ()
    raised: tuple[str, ...] = ()
    asked: tuple[tuple[Input, float], ...] = ()
    held: tuple[tuple[Input, float], ...] = ()
    quiet_s: float = 0.0
    flies_mission: bool = False

    @property
    def begins(self) -> str:
        """Where its flights begin: a mission, the ground, or the air."""
        on_ground = self.start is not None and self.start.altitude_m <= 0.0
        return "mission" if self.flies_mission else "ground" if on_ground else "air"

    def kinds(self) -> tuple[StimulusKind, ...]:
        """Return the kinds of its inputs, sorted."""
        return tuple(sorted({entry.kind for entry in (*self.inputs, *self.read)}))

    def names(self) -> tuple[str, ...]:
        """Return the names of all inputs that bear on it."""
        return tuple(entry.name for entry in (*self.inputs, *self.read))

    def orders(self) -> tuple[Input, ...]:
        """Return the commands whose values it reads: it is about what follows them."""
        return tuple(entry for entry in self.read if entry.kind == "command")


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
    raised: list[str] = []
    asked: list[tuple[Input, float]] = []
    held: list[tuple[Input, float]] = []
    quiet_s, flies_mission = 0.0, False
    for word in words:
        kind, _, name = word.partition(":")
        if kind == START:
            start = _start(name, text)
        elif kind == MISSION:
            flies_mission = True
        elif kind == RAISED:
            raised.append(name)
        elif kind == QUIET:
            quiet_s = _number(name, QUIET_MAX_S, text)
        elif kind == ASKS:
            name, _, value = name.partition("=")
            asked += [(entry, _number(value, math.inf, text)) for entry in named("parameter", [name], have, "hints")]
        elif kind == HOLDS:
            name, _, value = name.partition("=")
            held += [(entry, _number(value, math.inf, text)) for entry in named("stick", [name], have, "hints")]
        elif kind == IN:
            modes.extend(entry.name for entry in named("mode", [name], have, "hints"))
        elif kind == READS:
            kind, _, name = name.partition(":")
            read.extend(named(_kind(kind, text), [name], have, "hints"))
        else:
            inputs.extend(named(_kind(kind, text), [name], have, "hints"))
    if not policy:
        raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))
    return Hint(
        policy=policy,
        start=start,
        inputs=tuple(dict.fromkeys(inputs)),
        modes=tuple(modes),
        read=tuple(read),
        raised=tuple(raised),
        asked=tuple(asked),
        held=tuple(held),
        quiet_s=quiet_s,
        flies_mission=flies_mission,
    )


def _kind(word: str, text: str) -> StimulusKind:
    for kind in KINDS:
        if kind == word:
            return kind
    raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))


def _start(word: str, text: str) -> StartState:
    mode, _, rest = word.partition("@")
    height, _, how = rest.partition(":")
    if how not in ("", DISARMED):
        raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))
    return StartState(mode=mode, altitude_m=_number(height, HEIGHT_MAX_M, text), armed=not how)


def _number(word: str, most: float, text: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not abs(value) <= most:
        raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))
    return value
