"""A whole farm on one machine: which roles it has, and where it is reached, noted in its run folder."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import count as count_from
from pathlib import Path
from types import MappingProxyType
from typing import get_args

import msgspec

from saflite.bus.endpoints import check_endpoint, parse_endpoint
from saflite.bus.keyring import read_register
from saflite.bus.private_socket import PrivateSocket
from saflite.contract.control import Status
from saflite.contract.errors import Unavailable
from saflite.contract.work import Stage
from saflite.runtime import farm_register
from saflite.runtime.autoscaling import Autoscaler, Bounds
from saflite.runtime.client import FARM_FILE, FarmInfo, write_info
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.base import Launcher, Meeting, RoleSpec, RoleState
from saflite.runtime.launchers.local import LocalLauncher, PrefixOf
from saflite.runtime.launchers.split import SplitLauncher
from saflite.runtime.process_limits import prepare_limits
from saflite.runtime.supervisor import Failures, GaveUp, Supervisor
from saflite.scorer_pool.key_hosts import with_key_hosts

log = logging.getLogger(__name__)

Elsewhere = Callable[[Meeting], Launcher]

ELSEWHERE_PATIENCE_S = 60.0
BOOKS_FAILURES_MAX = 5  # books that cannot even start this often in a row end the farm
BREAKS_MAX = 20  # when all workers of a stage break this often in a row, each soon after its start, the farm ends
REFUSALS_MAX = 8  # a worker refused this often in a row, which takes longer than a dead one's name is held, does so too


class WorkerRefused(Unavailable):
    """The books let one of the farm's own workers in no more: its code is another than when the run began."""


def default_simulators() -> int:
    """Return one simulator per core this process may use."""
    return len(os.sched_getaffinity(0))


def scorers_for(simulators: int) -> int:
    """Return how many scorers so many simulators want.

    A round costs about as much to score as to fly, so one for every two and one more: a single one would let them wait.
    """
    return simulators // 2 + 1


def counts_of(simulators: int, *, record: bool = True) -> dict[Stage, int]:
    """Return the workers of a farm: mutator, scorers, oracle, recorder, simulators."""
    return {"mutate": 1, "score": scorers_for(simulators), "judge": 1, "record": int(record), "fly": simulators}


def with_scorers(scale: Mapping[Stage, Bounds]) -> dict[Stage, Bounds]:
    """Return bounds in which scorers follow simulators, unless they have their own."""
    fly = scale.get("fly")
    scorers: dict[Stage, Bounds] = {} if fly is None else {"score": Bounds(scorers_for(fly.min), scorers_for(fly.max))}
    return {**scorers, **scale}


def roles(simulators: int, *, record: bool = True, prefix: str = "") -> tuple[RoleSpec, ...]:
    """Return the roles of a farm: books with the router, and its workers; `prefix` begins the names of those."""
    return roles_of(counts_of(simulators, record=record), prefix=prefix)


def roles_of(counts: Mapping[Stage, int], *, prefix: str = "") -> tuple[RoleSpec, ...]:
    """Return the books with the router, and so many workers of each stage."""
    books = RoleSpec(kind="books", name="books", listens=True)
    workers = (worker_role(stage, number, prefix) for stage, count in counts.items() for number in range(1, count + 1))
    return (books, *workers)


def worker_role(stage: Stage, number: int, prefix: str = "") -> RoleSpec:
    """Return the role of the n-th worker of a stage."""
    return RoleSpec(kind=stage, name=f"{prefix}{stage}-{number}")


class LocalFarm:
    """The processes of one farm on this machine. Call `poll` often; it starts again what died.

    Args:
        campaign: its name.
        run_dir: its run folder.
        cast: the roles.
        modules: files of modules from outside, for every role that works.
        listen: the endpoint others may join at; a Unix socket that only this user reaches if left out.
        keys: the folder of the farm's keys, for an endpoint `tls/HOST:PORT`: those with a key join there, the
            farm's own roles meet on a private socket.
        insecure: allow an endpoint that others can reach.
        json_logs: write logs for machines.
        elsewhere: gives the launcher of all workers, told where they meet; this machine's own if left out.
        scale: bounds of the stages whose workers grow and shrink with their queues (`rescale`).
        prefix: what the names of workers begin with.
        key_hosts: hosts of model servers that scorers may send keys to, beside those of the environment.
        prefix_of: gives the words put before a role's command.
    """

    def __init__(
        self,
        campaign: str,
        run_dir: Path,
        cast: Sequence[RoleSpec],
        *,
        modules: Sequence[Path] = (),
        listen: str = "",
        keys: Path | None = None,
        insecure: bool = False,
        json_logs: bool = False,
        elsewhere: Elsewhere | None = None,
        scale: Mapping[Stage, Bounds] = MappingProxyType({}),
        prefix: str = "",
        key_hosts: Sequence[str] = (),
        prefix_of: PrefixOf = lambda _: (),
    ) -> None:
        prepare_limits(len(cast))
        gate = listen if keys is not None else ""
        if gate:
            check_endpoint(gate, insecure=False, keys=True, argument="--listen")
        self._socket = None if listen and not gate else PrivateSocket()
        text = self._socket.endpoint if self._socket else listen
        endpoint = check_endpoint(text, insecure=insecure, argument="--listen")
        self.campaign, self.run_dir, self.endpoint, self.insecure = campaign, run_dir, endpoint.from_here, insecure
        meeting = Meeting(
            campaign=campaign,
            connect=endpoint.from_here,
            listen=endpoint.text,
            gate=gate,
            insecure=insecure,
            json_logs=json_logs,
        )
        self._elsewhere = elsewhere(_met_elsewhere(meeting, keys)) if elsewhere is not None else None
        self._local = LocalLauncher(
            meeting,
            run_dir,
            run_dir=run_dir,
            modules=modules,
            keys=keys,
            prefix_of=prefix_of,
            variables_of=lambda spec: with_key_hosts(key_hosts) if spec.kind == "score" else {},
        )
        self._launcher = SplitLauncher(self._local, self._elsewhere) if self._elsewhere is not None else self._local
        self._modules = tuple(path.name for path in modules)
        self._autoscaler, self._prefix = Autoscaler(scale), prefix
        specs = [self._equipped(spec) if spec.kind in get_args(Stage) else spec for spec in cast]
        self._supervisor = Supervisor(self._launcher, specs, WallClock(), _gives_up)

    @property
    def restarts(self) -> int:
        """How often a role was started again."""
        return self._supervisor.restarts

    def start(self) -> None:
        """Start every role."""
        self._supervisor.start()
        self._write_info()
        farm_register.note(self.run_dir)

    def pids(self) -> dict[str, int]:
        """Return the process ids of the roles that run on this machine."""
        return self._local.pids()

    def poll(self) -> None:
        """Start again what died, after its back-off; a role that ended with code 0 has finished.

        Raises:
            Unavailable: the books cannot start, or all workers of a stage break again and again.
            WorkerRefused: a worker is refused again and again.
        """
        try:
            changed = self._supervisor.poll()
        except GaveUp as fault:
            logs = self.run_dir / "logs"
            if fault.state.condition == "broken":
                all_of = f"{fault.spec.kind} breaks again and again, {BREAKS_MAX} times so far"
                raise Unavailable(f"{all_of}: {fault.state.message}; see {logs}") from fault
            if fault.spec.kind != "books":
                raise WorkerRefused(f"{fault.spec.name} may not work for this run: {fault.state.message}") from fault
            raise Unavailable(f"{fault.spec.name} cannot start: {fault.state.message}; see {logs}") from fault
        if changed:
            self._write_info()

    def rescale(self, status: Status, now_s: float) -> None:
        """Start workers where the books' queues are deep, and let those go that are needed no more."""
        ours = {stage: self._supervisor.working(stage) for stage in self._autoscaler.stages}
        changes = self._autoscaler.changes(status, ours, now_s)
        for change in changes:
            now = len(ours[change.stage]) + change.grow - len(change.drain)
            log.info("%s: %d tasks, %d workers from now on", change.stage, status.queues.get(change.stage, 0), now)
            self._supervisor.drain(change.drain)
            for _ in range(change.grow):
                self._supervisor.add(self._next(change.stage))
        if changes:
            self._write_info()

    def over(self) -> bool:
        """Return whether the books have finished."""
        return self._supervisor.finished("books")

    def stop(self) -> None:
        """Stop clean: workers first (they hand back what they hold), books and router last; what stays is killed."""
        self._supervisor.stop()
        self._launcher.stop()
        with suppress(OSError):
            (self.run_dir / FARM_FILE).unlink()
        farm_register.forget(self.run_dir)
        if self._socket is not None:
            self._socket.close()

    def _next(self, stage: Stage) -> RoleSpec:
        """Return the role of the first number that is free; one that leaves still holds its name at the books."""
        specs = (worker_role(stage, number, self._prefix) for number in count_from(1))
        return self._equipped(next(spec for spec in specs if not self._supervisor.knows(spec.name)))

    def _equipped(self, spec: RoleSpec) -> RoleSpec:
        return msgspec.structs.replace(spec, modules=self._modules)

    def _write_info(self) -> None:
        info = FarmInfo(
            campaign=self.campaign,
            endpoint=self.endpoint,
            insecure=self.insecure,
            pid=os.getpid(),
            processes=self.pids(),
        )
        try:
            write_info(self.run_dir, info)
        except OSError as fault:  # tools that look for the farm find the older file; the farm goes on
            log.warning("%s not written: %s", FARM_FILE, fault)


def _met_elsewhere(meeting: Meeting, keys: Path | None) -> Meeting:
    """Return where workers of other machines meet: at the gate, by a name the router's certificate has."""
    connect = meeting.connect
    if meeting.gate and keys is not None:
        gate = parse_endpoint(meeting.gate)
        connect = gate.text if gate.text == gate.from_here else f"tls/{read_register(keys).hosts[0]}:{gate.port}"
    return msgspec.structs.replace(meeting, connect=connect, listen="", gate="", patience_s=ELSEWHERE_PATIENCE_S)


def _gives_up(spec: RoleSpec, state: RoleState, failures: Failures) -> bool:
    if spec.kind == "books" and state.condition in ("refused", "unavailable"):
        return failures.its_own >= BOOKS_FAILURES_MAX
    if state.condition == "broken":
        return failures.of_all >= BREAKS_MAX
    return state.condition == "refused" and failures.its_own >= REFUSALS_MAX
