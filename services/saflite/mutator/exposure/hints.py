"""What is known of each policy before any flight: the start state its file names, and inputs that bear on it."""

from __future__ import annotations

import math
from typing import NamedTuple, get_args

from saflite.contract.errors import Refused
from saflite.contract.test_case import StartState, StimulusKind, Twin
from saflite.mutator.operators.inputs import Have, Input, named

KINDS: tuple[StimulusKind, ...] = get_args(StimulusKind)
HEIGHT_MAX_M = 1e6
QUIET_MAX_S = 3600.0
START, IN, READS, MISSION, RAISED, QUIET = "start", "in", "reads", "mission", "raised", "quiet"
ASKS, HOLDS, PUSHES, FAR, UPSET, TWIN = "asks", "holds", "pushes", "far", "upset", "twin"
TWINS: tuple[Twin, ...] = tuple(twin for twin in get_args(Twin) if twin)
FAR_MAX_M = 1e5
DISARMED = "disarmed"
SHAPE = (
    "'<policy> start:<mode>@<metres>[:disarmed] mission: in:<mode> raised:<failsafe> quiet:<seconds> "
    "asks:<parameter>=<value> holds:<stick>=<value> pushes:<parameter>=<sense> far:<metres> upset: twin:<which> "
    "reads:<kind>:<input> <kind>:<input> ...'"
)


class Hint(NamedTuple):
    """One policy: where its flights may begin (None: where the campaign does), its own inputs.

    `modes` are those its formula names, `raised` the failsafes, `asked` settings with the values it compares them to,
    `held` sticks with values at which it asks them to stay, `pushed` settings that it compares a state with and the
    sense (1 up, -1 down) in which they make that true, `far_m` how far from home it wants the vehicle, `upset` if it is
    about a lost sensor, `twin` the second flight that it compares with, `read` the inputs whose values it reads; its
    state must last `quiet_s`; `flies_mission` if all is about missions.
    """

    policy: str
    start: StartState | None = None
    inputs: tuple[Input, ...] = ()
    modes: tuple[str, ...] = ()
    read: tuple[Input, ...] = ()
    raised: tuple[str, ...] = ()
    asked: tuple[tuple[Input, float], ...] = ()
    held: tuple[tuple[Input, float], ...] = ()
    pushed: tuple[tuple[Input, float], ...] = ()
    far_m: float = 0.0
    upset: bool = False
    twin: Twin = ""
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
    valued: dict[str, list[tuple[Input, float]]] = {ASKS: [], HOLDS: [], PUSHES: []}
    quiet_s, far_m, flies_mission, upset = 0.0, 0.0, False, False
    twin: Twin = ""
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
        elif kind == UPSET:
            upset = True
        elif kind == TWIN:
            twin = _twin(name, text)
        elif kind == FAR:
            far_m = _number(name, FAR_MAX_M, text)
        elif kind in valued:
            name, _, value = name.partition("=")
            entries = named("stick" if kind == HOLDS else "parameter", [name], have, "hints")
            valued[kind] += [(entry, _number(value, math.inf, text)) for entry in entries]
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
        asked=tuple(valued[ASKS]),
        held=tuple(valued[HOLDS]),
        pushed=tuple(valued[PUSHES]),
        far_m=far_m,
        upset=upset,
        twin=twin,
        quiet_s=quiet_s,
        flies_mission=flies_mission,
    )


def _kind(word: str, text: str) -> StimulusKind:
    for kind in KINDS:
        if kind == word:
            return kind
    raise Refused("strategy setting hints", expected=SHAPE, got=repr(text))


def _twin(word: str, text: str) -> Twin:
    for twin in TWINS:
        if twin == word:
            return twin
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
