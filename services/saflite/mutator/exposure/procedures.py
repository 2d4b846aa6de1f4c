"""Procedures of policies: how a flight tester would put a rule to the test, step by step, with room for what varies."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.test_case import Stimulus
from saflite.mutator.exposure.drawing import Drawing
from saflite.mutator.operators import values
from saflite.mutator.operators.commands import COUNT, place
from saflite.mutator.operators.inputs import Have, Input

Rng = np.random.Generator
AIR, GROUND, TAKEOFF, LAST = "air", "ground", "takeoff", "last"
WAIT, RELEASE, MAYBE, AT, USUAL, REST = "wait", "release", "?", "at", "~", "rest"
SHAPE = (
    "'<policy> <begin>; <step>; ...'. It begins 'air <metres>', on the 'ground', or there for a 'takeoff'; 'last' "
    "after that where nothing flies any more at the end. Steps: 'wait <seconds>', 'release' (of the sticks), "
    "'[?]<input> [<value> ...]', with '?' left out half the time. Inputs and values may be choices 'a|b', values "
    "ranges 'a..b', '~' (as usual) or 'rest'; of a command 'at <metres> <height>' is a place so far from home"
)
AT_ENDS = (
    0.15  # share of numbers at an end of their range, where they may mean something else: 0 for none, or as before
)
LEAST_WIDE = 5.0  # a range whose end is that many times its beginning is drawn from with all sizes alike
PAUSE_S = {"parameter": (0.05, 0.3), "mode": (0.2, 1.5)}  # after a step that nothing is waited for
SOON_S = (0.1, 0.8)
PARTS_MAX = 10  # of a step that may leave options open
NUMBERS_MAX, STEPS_MAX, WAIT_MAX_S, HEIGHT_MAX_M = 7, 40, 600.0, 1e4
_BEGIN = re.compile(rf"(?P<policy>\S+) (?:{AIR} (?P<height>\S+)|(?P<where>{GROUND}|{TAKEOFF}))(?P<last> {LAST})?")
_NUMBER = re.compile(r"-?\d{1,9}(\.\d{1,9})?")


class Span(NamedTuple):
    """Numbers from `low` to `high`."""

    low: float
    high: float

    def draw(self, rng: Rng) -> float:
        """Return one of them, now and then the first or the last."""
        if rng.random() < AT_ENDS:
            return self.low if rng.random() < 0.5 else self.high
        if self.low > 0.0 and self.high >= LEAST_WIDE * self.low:
            return math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        return float(rng.uniform(self.low, self.high))


Choice = tuple[Span, ...]
Choose = Callable[[int, int], int]
"""Which of so many options (second) is taken at a place of the procedure (first) that leaves one open."""


class Step(NamedTuple):
    """One of the inputs is given, with a number of each choice (`usual`: as the strategy draws it, else as it rests).

    Of a command `place` is how far from home (m) and how high (m). Without an input the sticks are let go where it
    says `release`, and `wait_s` goes by.
    """

    entries: tuple[Input, ...] = ()
    numbers: tuple[Choice, ...] = ()
    place: tuple[Choice, Choice] | None = None
    usual: bool = False
    maybe: bool = False
    release: bool = False
    wait_s: Span | None = None


class Procedure(NamedTuple):
    """Steps for a policy, and where they begin: in the air at a height (m), or on the ground with the motors off.

    One that begins on the ground stays there unless it `lifts`; after one that is `last` nothing flies any more.
    """

    policy: str
    height_m: Span | None
    lifts: bool
    last: bool
    steps: tuple[Step, ...]
    number: int = 0  # among those of its policy

    @property
    def begins(self) -> str:
        """Where it begins: the air, or the ground."""
        return AIR if self.height_m is not None else GROUND


class Move(NamedTuple):
    """A step as it is flown: a stimulus (None: the sticks are let go) and the time that goes by after it (s)."""

    stimulus: Stimulus | None
    after_s: float


def read_procedures(
    texts: Iterable[str], policies: Sequence[str] | None, have: Have
) -> dict[str, tuple[Procedure, ...]]:
    """Return the procedures of the campaign's policies, of all that are told where None is given.

    Raises Refused for a text of another shape, or an input the target does not have.
    """
    kept: dict[str, list[Procedure]] = {}
    for text in texts:
        one = _read(text, have)
        if policies is None or one.policy in policies:
            found = kept.setdefault(one.policy, [])
            found.append(one._replace(number=len(found)))
    return {policy: tuple(found) for policy, found in kept.items()}


def _read(text: str, have: Have) -> Procedure:
    head, *rest = [" ".join(part.split()) for part in text.split(";")]
    begin = _BEGIN.fullmatch(head)
    steps = tuple(_step(part, have, text) for part in rest if part)
    if begin is None or not 0 < len(steps) <= STEPS_MAX:
        raise _refused(text)
    height_m = _span(begin["height"], HEIGHT_MAX_M, text) if begin["height"] else None
    return Procedure(begin["policy"], height_m, begin["where"] == TAKEOFF, begin["last"] is not None, steps)


def _step(part: str, have: Have, text: str) -> Step:
    word, *numbers = part.split()
    if word == WAIT and len(numbers) == 1:
        return Step(wait_s=_span(numbers[0], WAIT_MAX_S, text))
    if part == RELEASE:
        return Step(release=True)
    maybe, names = word.startswith(MAYBE), word.removeprefix(MAYBE).split("|")
    entries = tuple(_entry(name, have, text) for name in names)
    is_mode = {entry.kind == "mode" for entry in entries}
    if len(is_mode) > 1 or (True in is_mode and numbers) or len(numbers) > NUMBERS_MAX + 1:
        raise _refused(text)
    if numbers in ([USUAL], []):
        return Step(entries, usual=True, maybe=maybe)
    if numbers == [REST] and not any(entry.kind == "command" for entry in entries):
        return Step(entries, maybe=maybe)
    if numbers[0] == AT and len(numbers) == 3 and all(entry.kind == "command" for entry in entries):
        far, high = (_choice(word, text) for word in numbers[1:])
        return Step(entries, place=(far, high), maybe=maybe)
    if len(numbers) > 1 and any(entry.kind != "command" for entry in entries):
        raise _refused(text)
    return Step(entries, tuple(_choice(word, text) for word in numbers), maybe=maybe)


def _entry(name: str, have: Have, text: str) -> Input:
    found = [entry for (_, known), entry in have.items() if known == name]
    if len(found) != 1:
        raise Refused("strategy setting procedures", where=repr(text), expected="an input of the target", got=name)
    return found[0]


def _choice(word: str, text: str) -> Choice:
    return tuple(_span(part, math.inf, text) for part in word.split("|"))


def _span(word: str, most: float, text: str) -> Span:
    ends = word.split("..")
    if not 1 <= len(ends) <= 2 or not all(_NUMBER.fullmatch(end) for end in ends):
        raise _refused(text)
    span = Span(float(ends[0]), float(ends[-1]))
    if span.low > span.high or max(abs(span.low), abs(span.high)) > most:
        raise _refused(text)
    return span


def _refused(text: str) -> Refused:
    return Refused("strategy setting procedures", expected=SHAPE, got=repr(text))


def moves(rng: Rng, procedure: Procedure, drawing: Drawing, choose: Choose | None = None) -> list[Move]:
    """Return the steps of a procedure with everything drawn that it leaves open; options by lot if nobody chooses."""
    made: list[Move] = []
    for number, step in enumerate(procedure.steps):
        pick = partial(_picked, rng, choose, number)
        if step.wait_s is not None:
            made.append((made.pop() if made else Move(None, 0.0))._replace(after_s=step.wait_s.draw(rng)))
        elif step.release:
            made.append(Move(None, 0.0))
        elif not step.maybe or pick(0, 2) == 0:
            stimulus = _given(rng, step, drawing, pick)
            low, high = (math.log(end) for end in PAUSE_S.get(stimulus.kind, SOON_S))
            made.append(Move(stimulus, math.exp(rng.uniform(low, high))))
    return made


def broken_off(rng: Rng, steps: Sequence[Move]) -> list[Move]:
    """Return the steps up to any of them, the time after which is cut short, too: what they began is under way."""
    kept = list(steps[: 1 + int(rng.integers(len(steps)))]) if steps else []
    if kept:
        kept[-1] = kept[-1]._replace(after_s=kept[-1].after_s * float(rng.random()))
    return kept


def without_entry(steps: Sequence[Move]) -> list[Move]:
    """Return the steps without the mode they begin in, where they give more than settings and modes after it.

    What they give then comes in whatever state is at hand: a radio that is lost in a return, not in LOITER alone.
    """
    kinds = [one.stimulus.kind if one.stimulus is not None else "" for one in steps]
    first = kinds.index("mode") if "mode" in kinds else len(kinds)
    if not any(kind not in ("parameter", "mode", "") for kind in kinds[first:]):
        return list(steps)
    return [*steps[:first], *steps[first + 1 :]]


def _picked(rng: Rng, choose: Choose | None, step: int, part: int, count: int) -> int:
    """Return one of `count` options at a part of a step: whether it comes, with which input, with which numbers."""
    if choose is None or count == 1:
        return int(rng.integers(count))
    return choose(step * PARTS_MAX + part, count)


def _given(rng: Rng, step: Step, drawing: Drawing, pick: Choose) -> Stimulus:
    entry = step.entries[pick(1, len(step.entries))]
    if step.usual:
        return drawing.moved(rng, entry) if entry.kind == "parameter" else drawing.given(rng, entry)
    if step.place is not None:
        far, high = (_drawn(rng, choice, pick, 2 + part) for part, choice in enumerate(step.place))
        return Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=place(rng, far, high))
    if not step.numbers:
        return drawing.at_rest(rng, entry)
    numbers = tuple(_fit(entry, _drawn(rng, choice, pick, 2 + part)) for part, choice in enumerate(step.numbers))
    unused = (0.0,) * (COUNT - len(numbers)) if entry.kind == "command" else ()
    return Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=(*numbers, *unused))


def _drawn(rng: Rng, choice: Choice, pick: Choose, part: int) -> float:
    return choice[pick(part, len(choice))].draw(rng)


def _fit(entry: Input, value: float) -> float:
    return float(round(value)) if entry.whole or entry.kind == "stick" else values.neat(value)
