"""Timed inputs of a test case: how each is given over MAVLink, and what became of it."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Mapping, MutableSequence, Sequence
from functools import cache
from typing import Any, NamedTuple

import msgspec

from saflite.contract.described import check_time_and_count
from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, DeliveryAnswer
from saflite.contract.test_case import Stimulus
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.mavlink.client import CUSTOM_MODE, DO_SET_MODE, IN_PROGRESS, Client

STICKS = {
    "RC1": "roll stick",
    "RC2": "pitch stick, below the centre is forward",
    "RC3": "throttle stick",
    "RC4": "yaw stick",
}
PULSE_LOW_US, PULSE_HIGH_US = 800, 2200
PATIENCE_S = 1.0  # simulated, for an answer
NUMBERS = 7
ACCEPTED = 0
PREFIX = "MAV_CMD_"


class Asked(NamedTuple):
    """An order that waits for its answer: its place in `Inputs.delivered`, what to look for."""

    place: int
    command: int
    parameter: str
    value: float
    until_s: float


class Inputs:
    """Gives each stimulus at its time, in order of time and place, and notes what became of it.

    Args:
        client: the link, polled by whoever flies.
        pulses_us: channels of the radio, sticks first.
        listing: the binary's parameters.
        modes: the numbers of DO_SET_MODE from its second on, for each mode.

    `on_accepted` is told each order that the autopilot took.
    """

    def __init__(
        self,
        client: Client,
        pulses_us: MutableSequence[int],
        stimuli: Sequence[Stimulus],
        listing: Listing,
        modes: Mapping[str, Sequence[float]],
    ) -> None:
        self._client, self._pulses_us, self._modes = client, pulses_us, modes
        self._types, self._values = listing.types, listing.values
        self.delivered: list[Delivered] = []
        self._stimuli = tuple(stimuli)
        self._order = sorted(range(len(stimuli)), key=lambda index: (stimuli[index].at_s, index))
        self.asked: list[Asked] = []
        self.on_accepted: Callable[[Stimulus], None] = lambda stimulus: None

    @property
    def last_s(self) -> float:
        """When the last stimulus is due."""
        return max((one.at_s for one in self._stimuli), default=0.0)

    def replace(self, stimuli: Sequence[Stimulus]) -> None:
        """Go on with other stimuli that are the same as far as they were given."""
        self._stimuli = tuple(stimuli)
        self._order = sorted(range(len(stimuli)), key=lambda index: (stimuli[index].at_s, index))
        self.delivered = [
            msgspec.structs.replace(one, index=self._order[place]) for place, one in enumerate(self.delivered)
        ]

    @property
    def finished(self) -> bool:
        """Whether everything was given and every answer came or is overdue."""
        return len(self.delivered) == len(self._order) and not self.asked

    def give_due(self, time_s: float) -> None:
        """Give what is due; note what was never answered."""
        self.asked = [one for one in self.asked if one.until_s > time_s]
        while len(self.delivered) < len(self._order):
            index = self._order[len(self.delivered)]
            if self._stimuli[index].at_s > time_s + 1e-9:
                return
            answer = self._give(self._stimuli[index], time_s)
            self.delivered.append(Delivered(index=index, at_s=max(time_s, self._stimuli[index].at_s), answer=answer))

    def hear(self, message: Any) -> None:
        """Take the answer in a message, if it is one."""
        kind = message.get_type()
        if kind == "COMMAND_ACK" and message.result != IN_PROGRESS:
            self._answered(lambda one: bool(one.command == message.command), message.result == ACCEPTED, message.result)
        elif kind == "PARAM_VALUE":
            told, before = self._told(message), self._values.get(message.param_id)
            self._values[message.param_id] = told
            for one in self.asked:
                if one.parameter == message.param_id:  # cut to a whole number or a limit it was taken all the same
                    taken = told != before or struct.pack("<f", told) == struct.pack("<f", one.value)
                    self._answered(lambda other, one=one: other is one, taken, f"kept {told:g}")
                    return

    def _answered(self, fits: Any, taken: bool, words: object) -> None:
        one = next((one for one in self.asked if fits(one)), None)
        if one is None:
            return
        self.asked.remove(one)
        answer: DeliveryAnswer = "accepted" if taken else "denied"
        said = "" if taken else f"result {words}" if isinstance(words, int) else str(words)
        entry = self.delivered[one.place]
        self.delivered[one.place] = msgspec.structs.replace(entry, answer=answer, message=said)
        if taken:
            self.on_accepted(self._stimuli[entry.index])

    # -- giving ---------------------------------------------------------------------------------------------------

    def _give(self, stimulus: Stimulus, time_s: float) -> DeliveryAnswer:
        if stimulus.kind == "stick":
            pulse_us = round(min(PULSE_HIGH_US, max(PULSE_LOW_US, stimulus.values[0])))
            self._pulses_us[int(stimulus.name.removeprefix("RC")) - 1] = pulse_us
            return "accepted"
        if stimulus.kind == "sensor_fault":
            return self._fault(stimulus.name, stimulus.values[0] if stimulus.values else 1.0, time_s)
        if stimulus.kind == "parameter":
            self._set(stimulus.name, stimulus.values[0], time_s)
        elif stimulus.kind == "mode":
            self._order_command(DO_SET_MODE, (CUSTOM_MODE, *self._modes[stimulus.name]), time_s)
        else:
            self._order_command(command_number(stimulus.name), stimulus.values, time_s)
        return "timed_out"  # unless an answer comes

    def _fault(self, name: str, value: float, time_s: float) -> DeliveryAnswer:
        """Put a fault on; here one is a parameter like any other."""
        self._set(name, value, time_s)
        return "timed_out"

    def _set(self, name: str, value: float, time_s: float) -> None:
        self._ask(time_s, parameter=name, value=value)
        sent, kind = self._client.encoded(value, self._types[name]), self._types[name]
        self._client.mav.param_set_send(1, 1, name.encode(), sent, kind)

    def _told(self, message: Any) -> float:
        return self._client.decoded(message.param_value, message.param_type)

    def _order_command(self, number: int, values: Sequence[float], time_s: float) -> None:
        self._ask(time_s, command=number)
        self._client.send_command(number, values)

    def _ask(self, time_s: float, *, command: int = -1, parameter: str = "", value: float = 0.0) -> None:
        self.asked.append(Asked(len(self.delivered), command, parameter, value, time_s + PATIENCE_S))


@cache
def command_numbers() -> dict[str, int]:
    """Return every MAV_CMD of the dialects we know by name."""
    from pymavlink.dialects.v20 import ardupilotmega

    return {entry.name: number for number, entry in ardupilotmega.enums["MAV_CMD"].items()}


def command_number(name: str) -> int:
    """Return the number of a MAV_CMD, with or without the prefix."""
    return command_numbers()[name if name.startswith(PREFIX) else PREFIX + name]


def check_stimulus(stimulus: Stimulus, known: Collection[str], modes: Collection[str], where: str) -> None:
    """Raise Refused for a stimulus that cannot even be given; `known` are the binary's parameters.

    Sensor faults are checked for their count of numbers only: what their names mean is the adapter's.
    """
    name, values = stimulus.name, stimulus.values
    check_time_and_count(stimulus, where)
    if stimulus.kind == "parameter":
        check_parameter(name, known, where)
    elif stimulus.kind == "stick" and name not in STICKS:
        raise Refused("stick", where=where, expected=f"one of {', '.join(STICKS)}", got=repr(name))
    elif stimulus.kind == "mode" and name not in modes:
        raise Refused("mode", where=where, expected=f"one of {', '.join(modes)}", got=repr(name))
    elif stimulus.kind == "command":
        _check_command(name, values, where)


def check_parameter(name: str, known: Collection[str], where: str) -> None:
    """Raise Refused for a parameter the binary does not have, naming the nearest it has."""
    if name not in known:
        expected = f"one of the binary's {len(known)}"
        raise Refused("parameter", where=where, expected=expected, got=repr(name), known=known)


def _check_command(name: str, values: Sequence[float], where: str) -> None:
    known = command_numbers()
    if (name if name.startswith(PREFIX) else PREFIX + name) not in known:
        expected = f"one of MAVLink's {len(known)} MAV_CMD"
        raise Refused("command", where=where, expected=expected, got=repr(name), known=known)
    if len(values) > NUMBERS:
        raise Refused("command values", where=where, expected=f"up to {NUMBERS} numbers", got=len(values))
