"""Commands in a PX4 log that came from outside the vehicle and were not refused."""

from __future__ import annotations

from collections import defaultdict, deque

import numpy as np

from saflite.contract.test_case import Stimulus
from saflite.flight.logs.commands import REFUSALS, command
from saflite.flight.logs.topics import Topics, field, times

_ACK = "vehicle_command_ack"
_ANSWER_S = 1.0  # PX4 answers within a few hundredths; a ground station asks again after a second or so


def commands_of(topics: Topics) -> list[Stimulus]:
    """Return what was ordered from outside (vehicle_command.from_external), times in seconds since boot."""
    topic = topics.get("vehicle_command", {})
    if not {"command", "from_external"} <= topic.keys():
        return []
    values = [np.asarray(topic.get(f"param{number}", np.zeros(len(topic["command"])))) for number in range(1, 8)]
    told = zip(times(topic), topic["command"], topic["from_external"], *values, strict=True)
    heard = [(float(at), int(number), bool(outside), given) for at, number, outside, *given in told]
    refused = _refused(topics, [(at, number) for at, number, _, _ in heard])
    orders = [one for place, one in enumerate(heard) if one[2] and place not in refused]
    made = [command(at, number, given) for at, number, _, given in orders]
    return [one for one in made if one is not None]


def _refused(topics: Topics, heard: list[tuple[float, int]]) -> set[int]:
    """Return the places of commands of which the answer says that they were not done (vehicle_command_ack).

    Commands of one number are answered in order, each once; those of the vehicle itself are, too.
    """
    answered, results = field(topics, _ACK, "command"), field(topics, _ACK, "result")
    if answered is None or results is None:
        return set()
    left: defaultdict[int, deque[tuple[float, int]]] = defaultdict(deque)
    for said_s, number, result in zip(*answered, results[1], strict=True):
        left[int(number)].append((said_s, int(result)))
    refused = set()
    for place, (at_s, number) in enumerate(heard):
        answers = left[number]
        while answers and answers[0][0] < at_s:
            answers.popleft()
        if answers and answers[0][0] <= at_s + _ANSWER_S and answers.popleft()[1] in REFUSALS:
            refused.add(place)
    return refused
