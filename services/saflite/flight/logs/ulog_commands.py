"""Commands in a PX4 log that came from outside the vehicle and were not refused."""

from __future__ import annotations

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
    heard = [(float(at), int(number), given) for at, number, outside, *given in told if outside]
    made = [command(at, number, given) for at, number, given in heard if not _refused(topics, at, number)]
    return [one for one in made if one is not None]


def _refused(topics: Topics, at_s: float, number: int) -> bool:
    """Return whether the answer to a command says that it was not done (vehicle_command_ack)."""
    answered, results = field(topics, _ACK, "command"), field(topics, _ACK, "result")
    if answered is None or results is None:
        return False
    said_s, commands = answered
    after = (commands == number) & (said_s >= at_s) & (said_s <= at_s + _ANSWER_S)
    return bool(after.any()) and int(results[1][np.argmax(after)]) in REFUSALS
