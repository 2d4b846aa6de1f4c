"""Timed inputs: parameters, commands, sticks, modes and sensor faults given to the autopilot during a flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from saflite.contract.described import check_time_and_count
from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, DeliveryAnswer
from saflite.contract.test_case import Stimulus
from saflite.flight.autopilots.reference.commands import MavResult, command_number, execute
from saflite.flight.autopilots.reference.modes.table import mode_table
from saflite.flight.autopilots.reference.parameters import parameter_table
from saflite.flight.autopilots.reference.sensor_faults import fault_parameter, fault_value

if TYPE_CHECKING:
    from saflite.flight.autopilots.reference.autopilot import Autopilot

STICKS = {f"RC{number}": number for number in range(1, 9)}
PULSE_US = (800.0, 2200.0)


class _Due(NamedTuple):
    """Something to be done; `place` is where the stimulus stands in the test case, -1 for the flight's own."""

    at_s: float
    place: int
    act: Callable[[], str]


class Player:
    """Gives each stimulus at its time, in order of time and place, and notes what became of it.

    Args:
        ap: the autopilot.
        stimuli: what is given.
        shown: signals of the trace; those that a stimulus changes at once are noted with it.
    """

    def __init__(self, ap: Autopilot, stimuli: Sequence[Stimulus], shown: Sequence[str] = ()) -> None:
        self._ap, self._shown = ap, shown
        self.delivered: list[Delivered] = []
        self._stimuli = tuple(stimuli)
        self._queue = [self._due(index) for index in in_order(self._stimuli)]

    @property
    def finished(self) -> bool:
        """Whether everything was given."""
        return not self._queue

    @property
    def last_s(self) -> float:
        """When the latest stimulus was given, 0 if none was."""
        return self.delivered[-1].at_s if self.delivered else 0.0

    def at(self, at_s: float, act: Callable[[], None]) -> None:
        """Add something of the flight's own to do."""

        def own() -> str:
            act()
            return ""

        self._queue = sorted([*self._queue, _Due(at_s, -1, own)], key=lambda due: due[:2])

    def tick(self, time_s: float) -> None:
        """Give what is due."""
        while self._queue and self._queue[0].at_s <= time_s + 1e-9:
            self._give(self._queue.pop(0), time_s)

    def replace(self, stimuli: Sequence[Stimulus]) -> None:
        """Give these from now on instead; what was given so far must be the same in both."""
        order = in_order(stimuli)
        given = [self._stimuli[index] for index in in_order(self._stimuli)[: len(self.delivered)]]
        assert given == [stimuli[index] for index in order[: len(given)]], "flown on with another past"
        self.delivered = [
            msgspec.structs.replace(one, index=index) for one, index in zip(self.delivered, order, strict=False)
        ]
        self._stimuli = tuple(stimuli)
        own = [due for due in self._queue if due.place < 0]
        self._queue = sorted([*own, *(self._due(index) for index in order[len(given) :])], key=lambda due: due[:2])

    def _due(self, index: int) -> _Due:
        stimulus = self._stimuli[index]
        check_stimulus(stimulus, f"stimulus {index}")
        return _Due(stimulus.at_s, index, lambda: give(self._ap, stimulus))

    def _give(self, due: _Due, time_s: float) -> None:
        answer: DeliveryAnswer = "timed_out"  # unless the autopilot lives to answer
        why, changed = "the autopilot died of it", {}
        before = self._show()
        try:
            why = due.act()
            answer = "denied" if why else "accepted"
            changed = {name: value for name, value in self._show().items() if value != before[name]}
        finally:
            if due.place >= 0:
                one = Delivered(index=due.place, at_s=time_s, answer=answer, message=why, changed=changed)
                self.delivered.append(one)

    def _show(self) -> dict[str, float]:
        """Return what a sample taken now would hold."""
        self._ap.publish()
        return {name: self._ap.board[name] for name in self._shown}


def in_order(stimuli: Sequence[Stimulus]) -> list[int]:
    """Return the places of stimuli in the order in which they are given: by time, then by place."""
    return sorted(range(len(stimuli)), key=lambda index: (stimuli[index].at_s, index))


def check_stimulus(stimulus: Stimulus, where: str) -> None:
    """Raise Refused for a stimulus this autopilot cannot even be sent."""
    check_time_and_count(stimulus, where)
    name, kind = stimulus.name, stimulus.kind
    if kind == "parameter" and name not in parameter_table():
        expected = "one of `saflite list parameters`"
        raise Refused("parameter", where=where, expected=expected, got=repr(name), known=parameter_table())
    if kind == "stick" and name not in STICKS:
        raise Refused("stick", where=where, expected="RC1 to RC8", got=repr(name))
    if kind == "mode" and name not in mode_table():
        raise Refused("mode", where=where, expected=f"one of {', '.join(mode_table())}", got=repr(name))
    if kind == "command":
        command_number(name, where)
        if len(stimulus.values) > 7:
            raise Refused("command values", where=where, expected="at most seven numbers", got=len(stimulus.values))
    if kind == "sensor_fault":
        fault_parameter(name, where)


def give(ap: Autopilot, stimulus: Stimulus) -> str:
    """Hand one input to the autopilot; return why it did not take it, empty if it did."""
    values = stimulus.values
    if stimulus.kind == "parameter":
        why = ap.parameters.set(stimulus.name, values[0])
        ap.say(f"Parameter {stimulus.name} = {values[0]:g}" + (f" refused: {why}" if why else ""))
        return why
    if stimulus.kind == "stick":
        ap.radio.stick(STICKS[stimulus.name], min(PULSE_US[1], max(PULSE_US[0], values[0])))
        return ""
    if stimulus.kind == "mode":
        why = ap.set_mode(stimulus.name, "pilot")
        if why:
            ap.say(f"mode {stimulus.name}: {why}", "warning")
        return why
    if stimulus.kind == "command":
        result = execute(ap, command_number(stimulus.name), values)
        ap.say(f"Command {stimulus.name}: {result.name}")
        return "" if result == MavResult.ACCEPTED else result.name
    name = fault_parameter(stimulus.name, "stimulus")
    why = ap.parameters.set(name, fault_value(stimulus.name, values[0] if values else 1.0))
    ap.say(f"Sensor fault {name}" + (f" refused: {why}" if why else ""))
    return why


def set_parameters(ap: Autopilot, parameters: Mapping[str, float]) -> None:
    """Set parameters before the start; raises Refused for one that is unknown or out of range."""
    for name, value in parameters.items():
        why = ap.parameters.set(name, value)
        if why:
            raise Refused(f"parameter {name}", expected="a known parameter within its range", got=f"{value:g}: {why}")
