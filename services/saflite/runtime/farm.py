"""A whole farm on one machine: which roles it has, and where it is reached, noted in its run folder."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import get_args

import msgspec

from saflite.bus.endpoints import check_endpoint, parse_endpoint
from saflite.bus.keyring import read_register
from saflite.bus.private_socket import PrivateSocket
from saflite.contract.errors import Unavailable
from saflite.contract.work import Stage
from saflite.runtime import farm_register
from saflite.runtime.client import FARM_FILE, FarmInfo, write_info
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.base import Launcher, Meeting, RoleSpec, RoleState
from saflite.runtime.launchers.local import LocalLauncher, PrefixOf
from saflite.runtime.launchers.split import SplitLauncher
from saflite.runtime.supervisor import GaveUp, Supervisor
from saflite.scorer_pool.key_hosts import with_key_hosts

log = logging.getLogger(__name__)

Elsewhere = Callable[[Meeting], Launcher]

ELSEWHERE_PATIENCE_S = 60.0
BOOKS_FAILURES_MAX = 5  # books that cannot even start this often in a row end the farm


def default_simulators() -> int:
    """Return one simulator per core this process may use."""
    return len(os.sched_getaffinity(0))


def roles(simulators: int, *, record: bool = True, prefix: str = "") -> tuple[RoleSpec, ...]:
    """Return the roles of a farm: books with the router, mutator, scorers, oracle, recorder, simulators.

    `prefix` begins the names of all but the books.

    A round costs about as much to score as to fly, so one scorer for every two simulators and one more: a single one
    would let them wait.
    """
    counts: dict[Stage, int] = {"mutate": 1, "score": simulators // 2 + 1, "judge": 1}
    return roles_of({**counts, "record": int(record), "fly": simulators}, prefix=prefix)


def roles_of(counts: Mapping[Stage, int], *, prefix: str = "") -> tuple[RoleSpec, ...]:
    """Return the books with the router, and so many workers of each stage."""
    books = RoleSpec(kind="books", name="books", listens=True)
    workers = (
        RoleSpec(kind=stage, name=f"{prefix}{stage}-{number}")
        for stage, count in counts.items()
        for number in range(1, count + 1)
    )
    return (books, *workers)


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
        key_hosts: Sequence[str] = (),
        prefix_of: PrefixOf = lambda _: (),
    ) -> None:
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
        names = tuple(path.name for path in modules)
        specs = [
            msgspec.structs.replace(spec, modules=names) if spec.kind in get_args(Stage) else spec for spec in cast
        ]
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
            Unavailable: the books cannot start.
        """
        try:
            changed = self._supervisor.poll()
        except GaveUp as fault:
            logs = self.run_dir / "logs"
            raise Unavailable(f"{fault.spec.name} cannot start: {fault.state.message}; see {logs}") from fault
        if changed:
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


def _gives_up(spec: RoleSpec, state: RoleState, failures: int) -> bool:
    no_start = spec.kind == "books" and state.condition in ("refused", "unavailable")
    return no_start and failures >= BOOKS_FAILURES_MAX
