"""Timed inputs: parameters, commands, sticks, modes and sensor faults given to the autopilot during a flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from saflite.contract.errors import Refused
from saflite.contract.test_case import Stimulus
from saflite.flight.autopilots.reference.commands import command_number, execute
from saflite.flight.autopilots.reference.sensor_faults import fault_parameter

if TYPE_CHECKING:
    from saflite.flight.autopilots.reference.autopilot import Autopilot

STICKS = {f"RC{number}": number for number in range(1, 9)}
PULSE_US = (800.0, 2200.0)


class Player:
    """Gives each stimulus at its time, in order of time and place."""

    def __init__(self, ap: Autopilot, stimuli: Sequence[Stimulus]) -> None:
        self._ap = ap
        queue: list[tuple[float, int, Callable[[], None]]] = []
        for index, stimulus in enumerate(stimuli):
            check_stimulus(stimulus, f"stimulus {index}")
            queue.append((stimulus.at_s, index, lambda stimulus=stimulus: give(ap, stimulus)))  # type: ignore[misc]
        self._queue = sorted(queue, key=lambda entry: entry[:2])

    @property
    def finished(self) -> bool:
        """Whether everything was given."""
        return not self._queue

    def at(self, at_s: float, act: Callable[[], None]) -> None:
        """Add something of the flight's own to do."""
        self._queue = sorted([*self._queue, (at_s, -1, act)], key=lambda entry: entry[:2])

    def tick(self, time_s: float) -> None:
        """Give what is due."""
        while self._queue and self._queue[0][0] <= time_s + 1e-9:
            self._queue.pop(0)[2]()


def check_stimulus(stimulus: Stimulus, where: str) -> None:
    """Raise Refused for a stimulus this autopilot cannot even be sent."""
    if stimulus.at_s < 0.0:
        raise Refused("stimulus time", where=where, expected="0 or later", got=stimulus.at_s)
    if stimulus.kind in ("parameter", "stick") and len(stimulus.values) != 1:
        raise Refused("stimulus values", where=where, expected="one number", got=stimulus.values)
    if stimulus.kind == "stick" and stimulus.name not in STICKS:
        raise Refused("stick", where=where, expected="RC1 to RC8", got=repr(stimulus.name))
    if stimulus.kind == "command" and len(stimulus.values) > 7:
        raise Refused("command values", where=where, expected="at most seven numbers", got=len(stimulus.values))
    if stimulus.kind == "sensor_fault":
        fault_parameter(stimulus.name, where)


def give(ap: Autopilot, stimulus: Stimulus) -> None:
    """Hand one input to the autopilot; what it makes of it shows in the trace's messages."""
    values = stimulus.values
    if stimulus.kind == "parameter":
        why = ap.parameters.set(stimulus.name, values[0])
        ap.say(f"Parameter {stimulus.name} = {values[0]:g}" + (f" refused: {why}" if why else ""))
    elif stimulus.kind == "stick":
        ap.radio.stick(STICKS[stimulus.name], min(PULSE_US[1], max(PULSE_US[0], values[0])))
    elif stimulus.kind == "mode":
        why = ap.set_mode(stimulus.name, "pilot")
        if why:
            ap.say(f"mode {stimulus.name}: {why}", "warning")
    elif stimulus.kind == "command":
        result = execute(ap, command_number(stimulus.name), values)
        ap.say(f"Command {stimulus.name}: {result.name}")
    else:
        name = fault_parameter(stimulus.name, "stimulus")
        why = ap.parameters.set(name, values[0] if values else 1.0)
        ap.say(f"Sensor fault {name}" + (f" refused: {why}" if why else ""))


def set_parameters(ap: Autopilot, parameters: Mapping[str, float]) -> None:
    """Set parameters before the start; raises Refused for one that is unknown or out of range."""
    for name, value in parameters.items():
        why = ap.parameters.set(name, value)
        if why:
            raise Refused(f"parameter {name}", expected="a known parameter within its range", got=f"{value:g}: {why}")
