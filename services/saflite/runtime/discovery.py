"""Which campaigns run at an endpoint: for whoever joins or asks there without naming one."""

from __future__ import annotations

import queue
from collections.abc import Sequence
from typing import TYPE_CHECKING

from saflite.bus.base import Bus, Happening, Presence
from saflite.contract import topics
from saflite.contract.clock import Clock
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.names import is_name
from saflite.runtime.clock import WallClock

if TYPE_CHECKING:
    from saflite.bus.zenoh import ZenohBus

LOOK_S = 2.0
OTHERS_S = 0.5  # after the first farm was found, others at the endpoint have this long to show


def only_campaign(bus: ZenohBus, endpoint: str, patience_s: float) -> str:
    """Return the one campaign that runs at an endpoint; waits for it up to `patience_s` (0: for ever).

    Raises:
        Refused: there are several, or the key on the bus counts for nothing.
        Unavailable: there is none.
    """
    if denied := bus.denied():
        raise Refused("key", expected="one that counts", got=denied)
    found = campaigns(bus, WallClock(), patience_s)
    if not found:
        raise Unavailable(f"no farm at {endpoint} has shown within {patience_s:.0f} s")
    if len(found) > 1:
        raise Refused("--campaign", expected=f"one of {', '.join(found)}, which run at {endpoint}", got="nothing")
    return found[0]


def campaigns(bus: Bus, clock: Clock, patience_s: float) -> Sequence[str]:
    """Return the campaigns whose books are on the bus; waits for the first up to `patience_s` (0: for ever)."""
    inbox: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    bus.watch(f"{topics.FARM_ROOT}/*", inbox.put)
    found: set[str] = set()
    until_s = clock.monotonic_s() + patience_s if patience_s else float("inf")
    while (left_s := until_s - clock.monotonic_s()) > 0:
        try:
            happening = inbox.get(timeout=min(left_s, LOOK_S))
        except queue.Empty:
            continue
        if isinstance(happening, Presence):
            name = happening.key.removeprefix(f"{topics.FARM_ROOT}/")
            if not is_name(name):
                continue
            (found.add if happening.present else found.discard)(name)
            until_s = min(until_s, clock.monotonic_s() + OTHERS_S)
    return sorted(found)
