"""How many workers of a stage a farm needs, from the books' view of its queues: pure, no clock and no launcher.

A worker always has a question open at the books, so it never looks idle from outside; what is queued and lent does. The
rule is that of horizontal autoscalers: grow at once to what is needed, shrink to the greatest need of a stabilization
window, so that a queue that runs dry between two rounds costs no worker.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple, get_args

import msgspec

from saflite.contract.control import Status
from saflite.contract.errors import Refused
from saflite.contract.work import Stage

STABILIZATION_S = 30.0
WORKERS_MAX = 1_000  # what the books take in


class Bounds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The fewest and the most workers of a stage."""

    min: int
    max: int


class Change(NamedTuple):
    """What to do about a stage: start `grow` more workers, drain those named."""

    stage: Stage
    grow: int = 0
    drain: tuple[str, ...] = ()


def parse_bounds(texts: Sequence[str], argument: str = "--scale") -> dict[Stage, Bounds]:
    """Return the bounds that texts like `fly=2:16` give; raises Refused for others."""
    found: dict[Stage, Bounds] = {}
    stages: dict[str, Stage] = {stage: stage for stage in get_args(Stage)}
    for text in texts:
        name, equals, bounds = text.partition("=")
        least, colon, most = bounds.partition(":")
        if not (equals and colon and _is_count(least) and _is_count(most)):
            raise Refused(argument, expected="STAGE=MIN:MAX, such as fly=2:16", got=repr(text))
        if name not in stages or name in found:
            raise Refused(argument, expected=f"a stage of {', '.join(stages)}, each once", got=repr(text))
        found[stages[name]] = Bounds(int(least), int(most))
    return check_bounds(found, argument)


def check_bounds(bounds: dict[Stage, Bounds], argument: str, where: str = "") -> dict[Stage, Bounds]:
    """Return the bounds; raises Refused unless 0 <= min <= max and max >= 1."""
    for stage, one in bounds.items():
        if not 0 <= one.min <= one.max <= WORKERS_MAX or one.max == 0:
            wanted = f"0 <= min <= max, and max 1 to {WORKERS_MAX}"
            raise Refused(f"{argument} {stage}", where=where, expected=wanted, got=f"min {one.min}, max {one.max}")
    return bounds


def _is_count(text: str) -> bool:
    return text.removeprefix("-").isdecimal() and len(text) <= 6


class Autoscaler:
    """Holds the numbers of workers of some stages between bounds. Call `changes` with each status of the books."""

    def __init__(self, bounds: Mapping[Stage, Bounds]) -> None:
        self._bounds = bounds
        self._needs: dict[Stage, deque[tuple[float, int]]] = {stage: deque() for stage in bounds}

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages it scales."""
        return tuple(self._bounds)

    def changes(self, status: Status, ours: Mapping[Stage, Sequence[str]], now_s: float) -> list[Change]:
        """Return what to change, given the names of our workers that are to work, by stage, the oldest first."""
        if status.state == "ended":
            return []
        changes = [self._change(stage, status, ours[stage], now_s) for stage in self._bounds]
        return [change for change in changes if change.grow or change.drain]

    def _change(self, stage: Stage, status: Status, ours: Sequence[str], now_s: float) -> Change:
        leases = {one.worker: one.leases for one in status.workers if one.stage == stage}
        bounds, needs = self._bounds[stage], self._needs[stage]
        needs.append((now_s, _need(status, stage, leases, ours)))
        while len(needs) > 1 and needs[1][0] <= now_s - STABILIZATION_S:  # one older than the window spans it
            needs.popleft()
        greatest = max(need for _, need in needs)
        excess = len(ours) - min(max(greatest, bounds.min), bounds.max)
        if excess <= 0:
            return Change(stage, grow=-excess)
        latest_first = tuple(reversed(ours))
        idlest = sorted(latest_first, key=lambda name: leases.get(name, 0))
        return Change(stage, drain=tuple(idlest[:excess]))


def _need(status: Status, stage: Stage, leases: Mapping[str, int], ours: Collection[str]) -> int:
    """Return how many tasks ask for one of our workers: those queued or lent to us; while paused, only the latter."""
    if status.state != "running":
        return sum(leases.get(name, 0) for name in ours)
    return status.queues.get(stage, 0) - sum(count for name, count in leases.items() if name not in ours)
