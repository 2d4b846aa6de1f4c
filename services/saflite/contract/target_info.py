"""What a target says of itself: inputs, signals, modes, settings and build. Travels on the wire; see `target.py`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

import msgspec

from saflite.contract.bounds import ITEMS_MAX, Number, Seconds, Text, Whole, Word
from saflite.contract.errors import Refused
from saflite.contract.names import Name
from saflite.contract.signals import TWIN_SIGNALS, Signal, can_show
from saflite.contract.test_case import Plain, Setting, StartState, StimulusKind, Twin

Repeats = Literal["bitwise", "statistically"]
"""Whether the same test case gives the same trace bit by bit, or only the same distribution of outcomes."""

Link = Literal["", "none", "setup", "pilot", "trusted"]
"""What somebody needs to give an input: nothing (the world does), the vehicle before its flight, the pilot's radio, a
telemetry or serial link; empty where its kind says it."""

COMPARED = ("x_m", "y_m", "altitude_m", "yaw_deg", "mode", "armed")
"""Signals by which a flight and its twin are compared."""

ValueType = Literal["real", "whole", "flag", "choice"]


class InputInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that can be given to a target, before the start (parameters) or during the flight.

    `low` and `high` bound the documented range, None where none is known; `choices` are the values of a `choice`.
    `at_start`: it acts when the flight starts only, and is given at 0 s. `restart`: it may be given in flight, too, but
    acts at the next start only. `link` is what it takes to give it.
    """

    kind: StimulusKind
    name: Word
    unit: Word = ""
    low: Number | None = None
    high: Number | None = None
    type: ValueType = "real"
    choices: Annotated[tuple[Number, ...], msgspec.Meta(max_length=10_000)] = ()
    default: Number | None = None
    meaning: Text = ""
    at_start: bool = False
    restart: bool = False
    link: Link = ""


class SettingInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One entry of the settings table of `Target`: what it does, its default, the values it may take if they are few.

    A setting whose default is a list takes any part of `choices`. By choice: `choice_meanings` says what it does,
    `breaks` which policy it is known to break (planted defects), `lacks` which inputs cannot be given with it.
    """

    meaning: Text
    default: Setting
    choices: Annotated[tuple[Plain, ...], msgspec.Meta(max_length=10_000)] = ()
    choice_meanings: Annotated[dict[Word, Text], msgspec.Meta(max_length=10_000)] = {}
    breaks: Annotated[dict[Word, Text], msgspec.Meta(max_length=10_000)] = {}
    lacks: Annotated[
        dict[Word, Annotated[tuple[Word, ...], msgspec.Meta(max_length=10_000)]], msgspec.Meta(max_length=1_000)
    ] = {}


class SignalInfo(msgspec.Struct, frozen=True, kw_only=True):
    """A signal of the target's own, beyond the common names of `contract/signals.py`."""

    unit: Word = ""
    meaning: Text = ""
    kind: Literal["real", "flag", "code"] = "real"

    def as_signal(self) -> Signal:
        """Return it as a row of the table of signals."""
        return Signal(self.unit, self.meaning, self.kind)


class TargetInfo(msgspec.Struct, frozen=True, kw_only=True):
    """What a target says of itself.

    `build` is a digest of all code and binaries that shape a trace; `signals` are the names every trace of it holds,
    `own_signals` describes those that are not common names; `modes` maps mode names to the numbers in the trace;
    `start_states` are examples of states a flight without mission may begin in, the first is the usual one;
    `missions` says whether it flies missions, `mission_lacks` which MAV_CMD (by number) it takes in none, `obstacles`
    whether it minds obstacles, `wind` whether it minds wind, `turns` whether it takes `TestCase.heading_deg`;
    `stock` tells whether the autopilot is built as its makers ship it, `options` what it was built with otherwise;
    `needs` names what it requires of a machine (for people and placement), `missing` what this machine lacks of it,
    empty if it can fly here.
    """

    name: Name
    build: Word
    repeats: Repeats
    inputs: Annotated[tuple[InputInfo, ...], msgspec.Meta(max_length=ITEMS_MAX)]
    signals: Annotated[tuple[Word, ...], msgspec.Meta(max_length=1_000)]
    own_signals: Annotated[dict[Word, SignalInfo], msgspec.Meta(max_length=1_000)] = {}
    modes: Annotated[dict[Word, Whole], msgspec.Meta(max_length=1_000)] = {}
    start_states: Annotated[tuple[StartState, ...], msgspec.Meta(max_length=1_000)] = ()
    settings: Annotated[dict[Word, SettingInfo], msgspec.Meta(max_length=1_000)] = {}
    missions: bool = False
    mission_lacks: Annotated[tuple[Whole, ...], msgspec.Meta(max_length=1_000)] = ()
    obstacles: bool = False
    wind: bool = False
    turns: bool = False
    snapshots: bool = False
    time_limit_max_s: Seconds = 7200.0
    vehicle: Text = ""
    autopilot: Text = ""
    stock: bool = True
    options: Text = ""
    needs: Annotated[tuple[Text, ...], msgspec.Meta(max_length=100)] = ()
    missing: Text = ""

    def lacking(self, given: Mapping[str, Setting]) -> frozenset[str]:
        """Return the names of inputs that cannot be given with these settings."""
        chosen = ((name, str(value)) for name, value in given.items() if name in self.settings)
        return frozenset(word for name, choice in chosen for word in self.settings[name].lacks.get(choice, ()))

    def flies_twin(self, twin: Twin) -> bool:
        """Return whether a second flight can be compared with the first here, and begin as this twin has to."""
        can_begin = twin not in ("turned", "mirrored") or self.turns
        return self.repeats == "bitwise" and can_begin and all(name in self.signals for name in COMPARED)

    def unseen(self, signals: Iterable[str], twin: Twin = "") -> list[str]:
        """Return those of the signals that no flight here shows, sorted; with a `twin` flights show how it differs."""
        more = TWIN_SIGNALS if twin and self.flies_twin(twin) else ()
        return sorted(name for name in signals if name not in more and not can_show(name, self.signals))


def check_settings(given: Mapping[str, Setting], known: Mapping[str, SettingInfo], target: str) -> None:
    """Raise Refused for a setting the target does not have, a value of another type or none of its choices."""
    for name, value in given.items():
        if name not in known:
            expected = f"a setting of {target}: {', '.join(sorted(known)) or 'it has none'}"
            raise Refused("target setting", expected=expected, got=repr(name), known=known)
        _check_value(f"target setting {name}", value, known[name])


def _check_value(where: str, value: Setting, info: SettingInfo) -> None:
    whole_as_real = isinstance(info.default, float) and type(value) is int
    if type(value) is not type(info.default) and not whole_as_real:
        raise Refused(where, expected=f"a value like {info.default!r}", got=repr(value))
    for part in value if isinstance(value, list) else [value]:
        if info.choices and part not in info.choices:
            raise Refused(where, expected=f"one of {', '.join(map(str, info.choices))}", got=repr(part))
