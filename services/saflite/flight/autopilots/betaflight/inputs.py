"""Timed inputs of a test case: which there are, and how each is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import msgspec

from saflite.contract.described import check_time_and_count
from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, DeliveryAnswer
from saflite.contract.test_case import Stimulus, TestCase
from saflite.flight.autopilots.betaflight import msp
from saflite.flight.autopilots.betaflight.configuration import known_settings
from saflite.flight.autopilots.betaflight.faults import (
    BAD_PULSE_US,
    LINK_BAD_PULSES,
    LINK_SILENT,
    bounded,
    check_fault,
    known_faults,
    set_fault,
)
from saflite.flight.autopilots.betaflight.firmware import Variant
from saflite.flight.autopilots.betaflight.in_flight import FIELDS
from saflite.flight.autopilots.betaflight.signals import show_setting
from saflite.flight.autopilots.betaflight.switches import (
    OFF_US,
    ON_US,
    PULSE_HIGH_US,
    PULSE_LOW_US,
    STICKS,
    SWITCHES,
    mode_channels,
    pilot_modes,
)
from saflite.flight.autopilots.betaflight.vehicle import TEST, Vehicle
from saflite.flight.autopilots.betaflight.wind import Air

SWITCH = "SWITCH_"
MSP_COMMAND, MSP2_COMMAND, RAW_BYTES = "MSP", "MSP2", "SERIAL_BYTES"
BYTES_MAX = 4096
PATIENCE_S = 0.5  # for an answer
TOO_LATE = "this setting is read at the start: give it at 0 s"


class Hands(Protocol):
    """What the inputs move: the pilot's sticks, the radio link, the air."""

    vehicle: Vehicle
    air: Air
    taken: set[int]
    link: int
    link_fault: int


class _Asked(NamedTuple):
    """A message that waits for its answer: its place in `Inputs.delivered`."""

    place: int
    command: int
    until_s: float


class _Change(NamedTuple):
    """A setting to be changed in flight: its place in `Inputs.delivered`, its name, the value."""

    place: int
    name: str
    value: float


class Inputs:
    """Gives each stimulus at its time, in order of time and place, and notes what became of it."""

    def __init__(self, hands: Hands, stimuli: Sequence[Stimulus], variant: Variant) -> None:
        self._hands, self._variant = hands, variant
        self.delivered: list[Delivered] = []
        self._stimuli = tuple(stimuli)
        self._order = in_order(self._stimuli)
        self._asked: list[_Asked] = []
        self._change_until_s = 0.0
        self._changes: list[_Change] = []  # one at a time: two of one block would undo each other

    @property
    def finished(self) -> bool:
        """Whether everything was given."""
        return len(self.delivered) == len(self._order)

    @property
    def last_s(self) -> float:
        """When the latest was given, 0 if none was."""
        return self.delivered[-1].at_s if self.delivered else 0.0

    def tick(self, time_s: float) -> None:
        """Give what is due; take the answers that came."""
        if self._asked or self._changes:
            self._hear(time_s)
        while not self.finished:
            index = self._order[len(self.delivered)]
            if self._stimuli[index].at_s > time_s + 1e-9:
                return
            self._give(index, time_s)

    def replace(self, stimuli: Sequence[Stimulus]) -> None:
        """Give these from now on instead; what was given so far must be the same in both."""
        order, count = in_order(stimuli), len(self.delivered)
        given = [self._stimuli[index] for index in self._order[:count]]
        assert given == [stimuli[index] for index in order[:count]], "flown on with another past"
        self.delivered = [
            msgspec.structs.replace(one, index=index) for one, index in zip(self.delivered, order, strict=False)
        ]
        self._stimuli, self._order = tuple(stimuli), order

    def _give(self, index: int, time_s: float) -> None:
        stimulus = self._stimuli[index]
        answer: DeliveryAnswer = "accepted"
        why = ""
        if stimulus.kind == "parameter":
            answer, why = self._change(stimulus, time_s)
        elif stimulus.name in (MSP_COMMAND, MSP2_COMMAND):
            answer = "timed_out"  # unless an answer comes
            self._asked.append(_Asked(len(self.delivered), int(stimulus.values[0]), time_s + PATIENCE_S))
            self._say(_message(stimulus))
        elif stimulus.name == RAW_BYTES:
            answer = "unanswered"
            self._say(bytes(int(value) for value in stimulus.values))
        else:
            give(self._hands, stimulus, self._variant)
        self.delivered.append(Delivered(index=index, at_s=time_s, answer=answer, message=why))

    def _change(self, stimulus: Stimulus, time_s: float) -> tuple[DeliveryAnswer, str]:
        field, value = FIELDS.get(stimulus.name), stimulus.values[0]
        if field is None:
            return "denied", TOO_LATE
        if not field.fits(value):
            return "denied", f"does not fit the {field.size} bytes of its message"
        self._changes.append(_Change(len(self.delivered), stimulus.name, value))
        if len(self._changes) == 1:
            self._begin_change(time_s)
        return "timed_out", ""  # unless an answer comes

    def _begin_change(self, time_s: float) -> None:
        """Ask for the block of the setting that is to be changed next."""
        self._change_until_s = time_s + PATIENCE_S
        self._say(msp.frame(FIELDS[self._changes[0].name].read))

    def _go_on_changing(self, answer: msp.Answer) -> bool:
        """Take an answer that a change waits for; return whether it was one."""
        change = self._changes[0]
        field = FIELDS[change.name]
        if answer.command == field.read:
            self._say(msp.frame(field.write, field.changed(answer.payload, change.value)))
        elif answer.command == field.write:
            self._settle(change.place, answer.taken)
            if answer.taken:
                show_setting(self._hands.vehicle, change.name, change.value)
            self._changes.pop(0)
        else:
            return False
        return True

    def _settle(self, place: int, taken: bool) -> None:
        answer: DeliveryAnswer = "accepted" if taken else "denied"
        words = "" if taken else "error answer"
        self.delivered[place] = msgspec.structs.replace(self.delivered[place], answer=answer, message=words)

    def _say(self, data: bytes) -> None:
        self._hands.vehicle.say(TEST, data)

    def _hear(self, time_s: float) -> None:
        for answer in msp.answers(self._hands.vehicle.heard(TEST)):
            waiting = len(self._changes)
            if waiting and self._go_on_changing(answer):
                if 0 < len(self._changes) < waiting:
                    self._begin_change(time_s)
                continue
            asked = next((one for one in self._asked if one.command == answer.command), None)
            if asked is not None:
                self._asked.remove(asked)
                self._settle(asked.place, answer.taken)
        if self._changes and time_s >= self._change_until_s:
            self._changes.pop(0)
            if self._changes:
                self._begin_change(time_s)
        self._asked = [one for one in self._asked if one.until_s > time_s]


def in_order(stimuli: Sequence[Stimulus]) -> list[int]:
    """Return the places of stimuli in the order in which they are given: by time, then by place."""
    return sorted(range(len(stimuli)), key=lambda index: (stimuli[index].at_s, index))


class Configured(NamedTuple):
    """A test case with the settings given at 0 s among those it starts with; `places` maps its stimuli to the given."""

    test_case: TestCase
    places: dict[int, int]
    given: tuple[Delivered, ...]


def configured(test_case: TestCase, variant: Variant) -> Configured:
    """Move settings given at 0 s to where they act: the command line, before the vehicle is armed.

    One outside its range is denied, as the command line does.
    """
    early = [i for i, one in enumerate(test_case.stimuli) if one.kind == "parameter" and one.at_s <= 0.0]
    if not early:
        return Configured(test_case, {i: i for i in range(len(test_case.stimuli))}, ())
    late = [i for i in range(len(test_case.stimuli)) if i not in early]
    known, parameters, given = known_settings(variant), dict(test_case.target.parameters), []
    for index in early:
        stimulus = test_case.stimuli[index]
        why = known[stimulus.name].why_not(stimulus.values[0])
        if not why:
            parameters[stimulus.name] = stimulus.values[0]
        given.append(Delivered(index=index, at_s=0.0, answer="denied" if why else "accepted", message=why))
    target = msgspec.structs.replace(test_case.target, parameters=parameters)
    stimuli = tuple(test_case.stimuli[i] for i in late)
    moved = msgspec.structs.replace(test_case, target=target, stimuli=stimuli)
    return Configured(moved, dict(enumerate(late)), tuple(given))


# ---- checks -------------------------------------------------------------------------------------------------------


def check_stimulus(stimulus: Stimulus, variant: Variant, where: str) -> None:
    """Raise Refused for a stimulus that cannot even be given."""
    check_time_and_count(stimulus, where)
    if stimulus.kind == "parameter":
        check_setting(stimulus.name, stimulus.values[0], variant, where)
    elif stimulus.kind == "stick" and stimulus.name not in STICKS:
        raise Refused("stick", where=where, expected=f"one of {', '.join(STICKS)}", got=repr(stimulus.name))
    elif stimulus.kind == "mode" and stimulus.name not in pilot_modes(variant.gps):
        expected = f"one of {', '.join(pilot_modes(variant.gps))}"
        raise Refused("mode", where=where, expected=expected, got=repr(stimulus.name))
    elif stimulus.kind == "sensor_fault":
        check_fault(stimulus.name, stimulus.values, variant.gps, where)
    elif stimulus.kind == "command":
        _check_command(stimulus, variant, where)


def check_setting(name: str, value: float, variant: Variant, where: str, *, strict: bool = False) -> None:
    """Raise Refused for a setting the build does not have; `strict`: for a value outside its range, too."""
    setting = known_settings(variant).get(name)
    if setting is None:
        expected = f"one of the {len(known_settings(variant))} settings of the {variant.name} build"
        raise Refused("parameter", where=where, expected=expected, got=repr(name), known=known_settings(variant))
    if strict and setting.why_not(value):
        raise Refused(f"parameter {name}", where=where, expected=setting.why_not(value), got=value)


def _check_command(stimulus: Stimulus, variant: Variant, where: str) -> None:
    commands = command_names(variant.gps)
    if stimulus.name not in commands:
        raise Refused("command", where=where, expected=f"one of {', '.join(commands)}", got=repr(stimulus.name))
    if stimulus.name.startswith(SWITCH):
        if len(stimulus.values) > 1:
            raise Refused("command values", where=where, expected="0 or 1", got=stimulus.values)
        return
    head = 0 if stimulus.name == RAW_BYTES else 1
    if not head <= len(stimulus.values) <= BYTES_MAX:
        raise Refused("command values", where=where, expected="a command number and bytes", got=len(stimulus.values))
    if any(value not in range(256) for value in stimulus.values[head:]):
        raise Refused("command values", where=where, expected="bytes, 0 to 255", got="others")
    if head and stimulus.values[0] not in range(65_536 if stimulus.name == MSP2_COMMAND else 256):
        raise Refused("command values", where=where, expected="a command number", got=stimulus.values[0])
    if stimulus.name == MSP_COMMAND and len(stimulus.values) > 1 + msp.PAYLOAD_V1_MAX:
        raise Refused("command values", where=where, expected="at most 255 bytes", got=len(stimulus.values) - 1)


def command_names(gps: bool) -> tuple[str, ...]:
    """Return the commands there are: a switch for each box, messages, bytes."""
    switches = tuple(f"{SWITCH}{name}" for name, switch in SWITCHES.items() if gps or not switch.gps)
    return (*switches, MSP_COMMAND, MSP2_COMMAND, RAW_BYTES)


# ---- giving -------------------------------------------------------------------------------------------------------


def give(hands: Hands, stimulus: Stimulus, variant: Variant) -> None:
    """Give a stick, a switch, a mode or a fault; none of them can be refused."""
    size = stimulus.values[0] if stimulus.values else 1.0
    if stimulus.kind == "stick":
        channel = int(stimulus.name.removeprefix("RC"))
        hands.taken.add(channel)
        hands.vehicle[f"rc_{channel}"] = float(round(min(PULSE_HIGH_US, max(PULSE_LOW_US, size))))
    elif stimulus.kind == "mode":
        for channel, pulse_us in mode_channels(stimulus.name).items():
            hands.vehicle[f"rc_{channel}"] = pulse_us
    elif stimulus.kind == "command":
        switch = SWITCHES[stimulus.name.removeprefix(SWITCH)]
        hands.vehicle[f"rc_{switch.channel}"] = ON_US if size >= 0.5 else OFF_US
    else:
        _give_fault(hands, stimulus.name, bounded(known_faults(variant.gps)[stimulus.name], size))


def _give_fault(hands: Hands, name: str, size: float) -> None:
    if name == "wind":
        hands.air.change(size)
    elif name == "radio_loss":
        hands.link_fault = round(size)
        hands.vehicle["rc_link"] = 0.0 if hands.link_fault == LINK_SILENT else float(hands.link)
    else:
        set_fault(hands.vehicle, name, size)


def spoil_pulses(hands: Hands) -> None:
    """While the link gives pulses out of range, the flight channels hold them."""
    if hands.link_fault == LINK_BAD_PULSES:
        for channel in range(1, 5):
            hands.vehicle[f"rc_{channel}"] = BAD_PULSE_US


def _message(stimulus: Stimulus) -> bytes:
    payload = bytes(int(value) for value in stimulus.values[1:])
    return msp.frame(int(stimulus.values[0]), payload, 2 if stimulus.name == MSP2_COMMAND else 1)
