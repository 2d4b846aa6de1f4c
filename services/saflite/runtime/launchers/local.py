"""A whole farm on one machine: starts the roles as processes, restarts dead ones, leaves no orphans."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO, TYPE_CHECKING, Literal, NamedTuple

from saflite.contract.config import Campaign
from saflite.contract.control import Control, Status
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.work import Stage
from saflite.runtime.client import FARM_FILE, FarmClient, FarmInfo, write_info
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.processes import adopt_orphans, children, kill_strays, signal_group

if TYPE_CHECKING:
    from saflite.campaign.storage.store import Store

log = logging.getLogger(__name__)

POLL_S = 0.05
LOCK_WAIT_S = 1.0
STATUS_S = 0.5
STATUS_PATIENCE_S = 2.0
BACK_OFF_FIRST_S, BACK_OFF_MAX_S = 0.2, 5.0
STEADY_S = 10.0  # a process that lived this long starts its back-off anew
STOP_GRACE_S = 8.0
BOOKS_FAILURES_MAX = 5  # books that cannot even start this often in a row end the farm

OnStatus = Callable[[Status], None]


class ExitSummary(NamedTuple):
    """How a local run ended. `ended` False: stopped before its end, `saflite resume` continues it."""

    ended: bool
    why: str
    status: Status | None
    restarts: int


class Role(NamedTuple):
    """One process of the farm. `prefix` is put before its command (a network namespace, a limit)."""

    name: str
    kind: Stage | Literal["books", "router"]
    prefix: tuple[str, ...] = ()


class _Child:
    """A role's process and its back-off."""

    def __init__(self, role: Role) -> None:
        self.role = role
        self.process: subprocess.Popen[bytes] | None = None
        self.started_s, self.start_at_s, self.wait_s = 0.0, 0.0, BACK_OFF_FIRST_S
        self.failures = 0
        self.finished = False


def roles(simulators: int, *, record: bool = True) -> tuple[Role, ...]:
    """Return the roles of a local farm: books with the router, mutator, scorers, oracle, recorder, simulators.

    A round costs about as much to score as to fly, so one scorer for every two simulators and one more: a single one
    would let them wait.
    """
    scorers = [Role(f"score-{number}", "score") for number in range(1, simulators // 2 + 2)]
    others = [Role("mutate-1", "mutate"), *scorers, Role("judge-1", "judge")]
    recorders = [Role("record-1", "record")] if record else []
    flyers = [Role(f"fly-{number}", "fly") for number in range(1, simulators + 1)]
    return (Role("books", "books"), *others, *recorders, *flyers)


def free_endpoint() -> str:
    """Return an endpoint on the loopback interface whose port is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class LocalFarm:
    """The processes of one farm. Call `poll` often; it restarts what died."""

    def __init__(
        self,
        campaign: str,
        run_dir: Path,
        cast: Sequence[Role],
        *,
        target_files: Sequence[Path] = (),
        endpoint: str = "",
    ) -> None:
        self.campaign, self.run_dir = campaign, run_dir
        self.endpoint = endpoint or free_endpoint()
        self.restarts = 0
        self._clock = WallClock()
        self._target_files = tuple(target_files)
        self._children = {role.name: _Child(role) for role in cast}
        self._router = "router" if any(role.kind == "router" for role in cast) else "books"
        (run_dir / "logs").mkdir(parents=True, exist_ok=True)
        adopt_orphans()
        self._bystanders = set(children(os.getpid()))

    def start(self) -> None:
        """Start every role."""
        for child in self._children.values():
            self._start(child)
        self._write_info()

    def pids(self) -> dict[str, int]:
        """Return the process ids of the roles that run."""
        running = {name: child.process for name, child in self._children.items()}
        return {name: process.pid for name, process in running.items() if process is not None}

    def poll(self) -> None:
        """Reap what died and start it again after its back-off; a role that ended with code 0 has finished.

        Raises:
            Unavailable: the books cannot start.
        """
        now_s = self._clock.monotonic_s()
        changed = False
        for child in self._children.values():
            if child.process is not None and child.process.poll() is not None:
                self._reap(child, child.process, now_s)
                changed = True
            if child.process is None and not child.finished and now_s >= child.start_at_s:
                self.restarts += 1
                self._start(child)
                changed = True
        kill_strays(self._bystanders | set(self.pids().values()))
        if changed:
            self._write_info()

    def over(self) -> bool:
        """Return whether the books have finished."""
        return self._children["books"].finished

    def stop(self) -> None:
        """Stop clean: workers first (they hand back what they hold), books and router last; what stays is killed."""
        centre = ("books", "router")
        self._end([child for child in self._children.values() if child.role.kind not in centre])
        for kind in centre:
            self._end([child for child in self._children.values() if child.role.kind == kind])
        kill_strays(self._bystanders)
        with suppress(OSError):
            (self.run_dir / FARM_FILE).unlink()

    def _end(self, children: Sequence[_Child]) -> None:
        running = [child.process for child in children if child.process is not None]
        for process in running:
            with suppress(ProcessLookupError):
                process.terminate()
                process.send_signal(signal.SIGCONT)
        until_s = self._clock.monotonic_s() + STOP_GRACE_S
        for process in running:
            try:
                process.wait(max(0.0, until_s - self._clock.monotonic_s()))
            except subprocess.TimeoutExpired:
                log.warning("process %d does not stop; killed", process.pid)
                signal_group(process.pid, signal.SIGKILL)
                process.wait()
        for child in children:
            child.process, child.finished = None, True

    def _reap(self, child: _Child, process: subprocess.Popen[bytes], now_s: float) -> None:
        signal_group(process.pid, signal.SIGKILL)
        child.process = None
        child.finished = process.returncode == 0
        if child.finished:
            return
        was_killed = process.returncode in (-signal.SIGKILL, -signal.SIGTERM)  # from outside, not by a fault of its own
        steady = was_killed or now_s - child.started_s > STEADY_S
        child.failures = 1 if steady else child.failures + 1
        child.wait_s = BACK_OFF_FIRST_S if steady else min(2 * child.wait_s, BACK_OFF_MAX_S)
        child.start_at_s = now_s + child.wait_s
        log.warning("%s ended with code %s, starting it again", child.role.name, process.returncode)
        if child.role.kind == "books" and process.returncode in (2, 3) and child.failures >= BOOKS_FAILURES_MAX:
            raise Unavailable(f"the books do not start; see {self._log(child.role)}")

    def _start(self, child: _Child) -> None:
        role = child.role
        command = [*role.prefix, sys.executable, "-m", "saflite.runtime.serve", role.kind, "--campaign", self.campaign]
        command += ["--worker", role.name, "--parent", str(os.getpid()), "--run-dir", str(self.run_dir)]
        command += ["--listen" if role.kind == self._router else "--connect", self.endpoint]
        command += ["--spool", str(self.run_dir / "spool" / role.name)]
        for path in self._target_files if role.kind == "fly" else ():
            command += ["--target-module", str(path)]
        with self._sink(role) as sink:
            child.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=sink, stderr=sink, start_new_session=True
            )
        child.started_s = self._clock.monotonic_s()

    def _sink(self, role: Role) -> IO[bytes]:
        try:
            return self._log(role).open("ab")
        except OSError as fault:  # a full disk must not end the farm
            log.warning("no log for %s: %s", role.name, fault)
            return open(os.devnull, "wb")

    def _log(self, role: Role) -> Path:
        return self.run_dir / "logs" / f"{role.name}.log"

    def _write_info(self) -> None:
        info = FarmInfo(campaign=self.campaign, endpoint=self.endpoint, pid=os.getpid(), processes=self.pids())
        try:
            write_info(self.run_dir, info)
        except OSError as fault:  # tools that look for the farm find the older file; the farm goes on
            log.warning("%s not written: %s", FARM_FILE, fault)


def default_simulators() -> int:
    """Return one simulator per core this process may use."""
    return len(os.sched_getaffinity(0))


def run_campaign(
    campaign: Campaign,
    run_dir: Path,
    *,
    simulators: int | None = None,
    on_status: OnStatus | None = None,
    target_files: Sequence[Path] = (),
) -> ExitSummary:
    """Run a new campaign to its end on this machine.

    Raises:
        Refused: `run_dir` exists, or the campaign cannot be run.
        Unavailable: the farm cannot start.
    """
    from saflite.campaign.presets.campaigns import template
    from saflite.campaign.storage.store import Store

    Store.create(run_dir, campaign, template(campaign)).close()
    return resume(run_dir, simulators=simulators, on_status=on_status, target_files=target_files)


def resume(
    run_dir: Path,
    *,
    simulators: int | None = None,
    on_status: OnStatus | None = None,
    target_files: Sequence[Path] = (),
    budget: int | None = None,
) -> ExitSummary:
    """Continue the campaign in `run_dir` to its end on this machine, with a new budget if one is given.

    Raises:
        Refused: no run folder, one in use, or a damaged store.
        Unavailable: the farm cannot start.
    """
    store = _open(run_dir)
    campaign = store.campaign
    if budget is not None:
        _raise_budget(store, budget)
    store.close()
    cast = roles(simulators or default_simulators(), record=campaign.record != "none")
    farm = LocalFarm(campaign.name, run_dir, cast, target_files=target_files)
    with _interrupts() as interrupted:
        try:
            farm.start()
            return _follow(farm, on_status, interrupted)
        finally:
            farm.stop()


def _open(run_dir: Path) -> Store:
    """Open the store; waits a moment for one just killed, whose lock goes only with its last file."""
    from saflite.campaign.storage.sqlite import InUse
    from saflite.campaign.storage.store import Store

    clock = WallClock()
    until_s = clock.monotonic_s() + LOCK_WAIT_S
    while True:
        try:
            return Store.open(run_dir)
        except InUse:
            if clock.monotonic_s() > until_s:
                raise
            clock.sleep_s(POLL_S)


def _raise_budget(store: Store, budget: int) -> None:
    """Give the order before anybody works: an ended campaign would send its workers home first."""
    clock = WallClock()
    books = store.rebuild()
    books.begin(clock.monotonic_s(), clock.unix_s())
    answer = books.control(Control(verb="budget", number=budget), clock.monotonic_s())
    if not answer.accepted:
        store.close()
        raise Refused("budget", expected="one the books accept", got=answer.message)
    store.commit(books.drain())


def _follow(farm: LocalFarm, on_status: OnStatus | None, interrupted: list[str]) -> ExitSummary:
    clock = WallClock()
    status: Status | None = None
    client: FarmClient | None = None
    next_s = clock.monotonic_s()
    try:
        while not interrupted and not farm.over():
            farm.poll()
            clock.sleep_s(POLL_S)
            if clock.monotonic_s() < next_s:
                continue
            try:
                client = client or FarmClient.connect(farm.endpoint, farm.campaign, tries=1)
                status = client.status(within_s=STATUS_PATIENCE_S)
            except Unavailable as fault:
                log.info("%s", fault)
            else:
                if on_status is not None:
                    on_status(status)
                if status.state == "ended":
                    return ExitSummary(True, "the campaign is over", status, farm.restarts)
            next_s = clock.monotonic_s() + STATUS_S
    finally:
        if client is not None:
            client.close()
    why = interrupted[0] if interrupted else "the campaign is over"
    return ExitSummary(farm.over(), why, status, farm.restarts)


@contextmanager
def _interrupts() -> Iterator[list[str]]:
    """Turn Ctrl-C and SIGTERM into a note instead of an end, while the farm runs."""
    noted: list[str] = []

    def note(number: int, _frame: FrameType | None) -> None:
        noted.append(f"signal {signal.Signals(number).name}")

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
