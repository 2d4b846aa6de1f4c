"""Does a target do what it says of itself? Its description, and short flights in a sandbox, the first flown twice."""

from __future__ import annotations

from collections.abc import Iterator

from saflite.contract.errors import Unavailable
from saflite.contract.flight import FLOWN_ENDINGS, Flight
from saflite.contract.target_info import TargetInfo
from saflite.contract.work import FlyResult, FlyWork

WALL_LIMIT_S = 300.0  # a real autopilot is brought up anew for each flight, on a machine that may be busy


def target_words(name: str) -> tuple[bool, str]:
    """Return whether a target is sound, and what was seen.

    Raises:
        Refused: it contradicts its description; the text says where.
        Unavailable: it cannot fly here.
    """
    from saflite.simulator_worker.registry import describe_target

    info = describe_target(name)
    if info.missing:
        raise Unavailable(info.missing)
    for flight in _flown(info):
        if flight.ending not in FLOWN_ENDINGS:
            return False, f"a flight of {flight.simulated_s:g} s ended as {flight.ending}: {flight.message}"
    again = "flown twice, equal bit by bit" if info.repeats == "bitwise" else "repeats statistically"
    return True, f"build {info.build[:12]}, {len(info.inputs)} inputs, {len(info.signals)} signals, {again}"


def _flown(info: TargetInfo) -> Iterator[Flight]:
    """Yield flights without and with inputs of every kind, up to the first that says nothing of the vehicle."""
    from saflite.conformance.target_cases import default_cases
    from saflite.evidence.memory import MemoryBlobs
    from saflite.runtime.clock import WallClock
    from saflite.simulator_worker.work import open_service

    flyer = open_service("doctor", WallClock(), MemoryBlobs(), verify=True)
    try:
        for case in default_cases(info):
            work = FlyWork(test_case=case, flight_index=0, purpose="replay", wall_limit_s=WALL_LIMIT_S)
            result = flyer.do(work, lambda: False)
            assert isinstance(result, FlyResult), f"a simulator worker answered with {type(result).__name__}"
            yield result.flight
    finally:
        flyer.close()
