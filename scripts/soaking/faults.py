"""The faults a soak injects from outside. Each returns what it did, or None where it cannot be done right now."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from byzantine_client import ByzantineClient
from testbed import Testbed

from saflite.simulator_worker.processes import children

COMMIT_HUNT_S = 1.5


class Done(NamedTuple):
    """What was done: to whom, and what has to be undone after how long."""

    whom: str
    undo: Callable[[], None] | None = None
    after_s: float = 0.0


class Injected(NamedTuple):
    """One fault as it happened."""

    kind: str
    whom: str
    at_s: float
    at_unix_s: float
    until_s: float


class FaultContext(NamedTuple):
    """What faults need."""

    testbed: Testbed
    false_client: ByzantineClient
    damaging_client: ByzantineClient
    rng: np.random.Generator
    freeze_s: float


Fault = Callable[[FaultContext], Done | None]


def _pick(context: FaultContext, kind: str) -> tuple[str, int] | None:
    names = [name for name in context.testbed.farm.pids() if name.startswith(kind)]
    if not names:
        return None
    name = names[int(context.rng.integers(len(names)))]
    return name, context.testbed.farm.pids()[name]


def killer(kind: str) -> Fault:
    """Return the fault that kills a role of this kind with SIGKILL."""

    def kill(context: FaultContext) -> Done | None:
        found = _pick(context, kind)
        if found is None:
            return None
        os.kill(found[1], signal.SIGKILL)
        return Done(found[0])

    return kill


def kill_in_commit(context: FaultContext) -> Done | None:
    """Kill the books the moment their write-ahead log changes: in the middle of a commit, or just after it."""
    pid = context.testbed.farm.pids().get("books")
    log = context.testbed.run_dir / "books.sqlite-wal"
    if pid is None or not log.exists():
        return None
    before = log.stat().st_mtime_ns, log.stat().st_size
    until_s = context.testbed.clock.monotonic_s() + COMMIT_HUNT_S
    while context.testbed.clock.monotonic_s() < until_s:
        with suppress(FileNotFoundError):
            if (log.stat().st_mtime_ns, log.stat().st_size) != before:
                os.kill(pid, signal.SIGKILL)
                return Done("books")
    return None


def kill_simulator(context: FaultContext) -> Done | None:
    """Kill the simulator under a worker."""
    found = _pick(context, "fly")
    below = children(found[1]) if found is not None else []
    if found is None or not below:
        return None
    os.kill(below[0], signal.SIGKILL)
    return Done(found[0])


def freezer(kind: str) -> Fault:
    """Return the fault that stops a role of this kind with SIGSTOP for a while."""

    def freeze(context: FaultContext) -> Done | None:
        found = _pick(context, kind)
        if found is None:
            return None
        name, pid = found
        os.kill(pid, signal.SIGSTOP)

        def thaw() -> None:
            if context.testbed.farm.pids().get(name) == pid:
                os.kill(pid, signal.SIGCONT)

        return Done(name, thaw, context.freeze_s)

    return freeze


def cut_network(context: FaultContext) -> Done | None:
    """Pull the cable of the worker in the namespace."""
    if context.testbed.network.why_not:
        return None
    context.testbed.network.cut()
    return Done("fly-2", context.testbed.network.join, float(context.rng.uniform(1.0, 6.0)))


def fill_disk(context: FaultContext) -> Done | None:
    """Fill the disk of the run folder."""
    if context.testbed.disk.why_not:
        return None
    context.testbed.disk.fill()
    return Done("disk", context.testbed.disk.free, float(context.rng.uniform(0.5, 3.0)))


def client_fault(name: str) -> Fault:
    """Return the fault of that name a byzantine participant can make, if it is not at something else."""

    def act(context: FaultContext) -> Done | None:
        client = context.false_client if name in ByzantineClient.FALSE_RESULTS else context.damaging_client
        return Done("byzantine client") if client.start_fault(name) else None

    return act


ROLES = ("books", "router", "mutate", "score", "judge", "record", "fly")

KINDS: dict[str, Fault] = {
    **{f"kill {role}": killer(role) for role in ROLES},
    "kill books in commit": kill_in_commit,
    "kill simulator": kill_simulator,
    **{f"freeze {role}": freezer(role) for role in ROLES},
    "cut network": cut_network,
    "fill disk": fill_disk,
    **{name: client_fault(name) for name in (*ByzantineClient.FALSE_RESULTS, *ByzantineClient.DAMAGE)},
}

HEAVY = ("freeze books", "freeze router", "fill disk", "cut network")
"""Faults that stop the whole farm or half of it; dealt less often than the others so that work goes on between."""
