"""The launcher of a Ray cluster: one actor per role, placed where there is room, again elsewhere when its node dies.

Ray only places processes and tells when they are gone. An actor starts its role as a process of its node, which opens
its own session on the bus; no work, no result and no state of the campaign passes through Ray, so an outage of it costs
capacity and nothing else. Nothing is taken for granted of the nodes but that the same package is installed on them:
modules and keys travel with the actor, traces over the bus.
"""

from __future__ import annotations

import fcntl
import logging
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from shutil import rmtree
from typing import Any, NamedTuple

import ray
from ray.exceptions import GetTimeoutError, RayActorError, RayError

from saflite.contract.config import environment
from saflite.contract.errors import Refused, Unavailable
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.base import Meeting, RoleSpec, RoleState
from saflite.runtime.launchers.local import STOP_GRACE_S, LocalLauncher

log = logging.getLogger(__name__)

STOP_WAIT_S = STOP_GRACE_S + 4.0
CPUS_OF = {"fly": 0.8}  # so that one simulator per core leaves room for the small roles wherever they are placed
CPUS_OTHERWISE = 0.02  # not 0: a node with such roles alone would count as idle
LEAVE_S = 2.0  # for an actor whose role has ended, or that hangs, to take its folder away before it is killed
FOLDERS = "saflite-on-ray-"
REACH_S = 3.0
DROP_S = 5.0
HANGS_S = 30.0  # an actor that answers no more (its node frozen or cut off) is given up and placed anew
OBJECT_STORE_BYTES = 100 * 2**20  # nothing of ours goes through it


class Luggage(NamedTuple):
    """What a role needs and may not find where it is placed: files by name, for modules and for keys."""

    modules: dict[str, bytes]
    keys: dict[str, bytes]
    variables: dict[str, str]


class Place:
    """An actor: the process of one role, on whatever node it was placed."""

    def __init__(self, meeting: Meeting, spec: RoleSpec, luggage: Luggage) -> None:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # Ray may ignore it: then a killed process would read as finished
        _sweep()
        self._folder, self._lock = _folder(spec.name)
        modules = [_unpacked(self._folder / "modules", name, data) for name, data in luggage.modules.items()]
        keys = [_unpacked(self._folder / "keys", name, data) for name, data in luggage.keys.items()]
        self._launcher = LocalLauncher(
            meeting,
            self._folder,
            modules=modules,
            keys=keys[0].parent if keys else None,
            variables_of=lambda _: luggage.variables,
        )
        self._name = spec.name
        self._launcher.start(spec)

    def state(self) -> tuple[str, str]:
        """Return the role's condition and last words."""
        state = self._launcher.poll()[self._name]
        return state.condition, state.message

    def drain(self) -> None:
        """Have the role finish what it holds and end."""
        self._launcher.drain([self._name])

    def stop(self) -> None:
        """End the role, and leave nothing behind."""
        self._launcher.stop()
        rmtree(self._folder, ignore_errors=True)
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


class _Placed:
    """An actor as the launcher sees it: the question under way and what it said last."""

    def __init__(self, actor: Any) -> None:
        self.actor = actor
        self.asked = actor.state.remote()
        self.state = RoleState("running", "not placed yet")
        self._heard_s: float | None = None  # None: waiting for room, which may take for ever

    @property
    def waits(self) -> bool:
        """Whether it was never heard of: there is no room for it, or it has only just begun."""
        return self._heard_s is None

    def look(self, now_s: float) -> RoleState:
        """Take the answer if it is there, and ask again; never waits. An actor that has answered once must go on to."""
        ready, _ = ray.wait([self.asked], timeout=0)
        if ready:
            self._heard_s = now_s
        elif self._heard_s is not None and now_s - self._heard_s > HANGS_S:
            self.state = RoleState("killed", f"its actor has not answered for {now_s - self._heard_s:.0f} s")
        if ready:
            try:
                condition, message = ray.get(self.asked)
                self.state = RoleState(condition, message)
            except RayActorError as fault:
                self.state = RoleState("killed", _first_line(fault))
            except RayError as fault:
                self.state = RoleState("unavailable", _first_line(fault))
            if self.state.condition == "running":
                self.asked = self.actor.state.remote()
        return self.state

    def end(self) -> None:
        """Drop the actor, and with it whatever it started; its folder stays unless it was told to stop before."""
        ray.kill(self.actor, no_restart=True)


def _end(placed: Collection[_Placed], within_s: float) -> int:
    """Have actors stop, all at once, and drop them; returns how many did not stop in time."""
    stops = [one.actor.stop.remote() for one in placed]
    late = ray.wait(stops, num_returns=len(stops), timeout=within_s)[1] if stops else []
    _drop(placed)
    return len(late)


def _drop(placed: Collection[_Placed]) -> None:
    """Drop actors, those last that wait for room: while the cluster's head is away, that waits until it is back."""

    def drop() -> None:
        with suppress(Exception):  # left meanwhile, or the cluster has gone: nothing is there to be dropped
            for one in sorted(placed, key=lambda one: one.waits):
                one.end()

    dropping = threading.Thread(target=drop, name="drop", daemon=True)
    dropping.start()
    dropping.join(DROP_S)


class RayLauncher:
    """Roles as actors of a Ray cluster.

    Args:
        meeting: where the roles meet; its `connect` must be reached from every node.
        address: of the cluster; `auto` for the one this machine belongs to, empty to start one here.
        modules: files of modules from outside, sent along.
        keys: the folder of the key that all roles show, where the endpoint wants one.
        variables_of: gives what is set in a role's environment.

    Raises:
        Unavailable: no cluster is reached.
    """

    def __init__(
        self,
        meeting: Meeting,
        address: str = "",
        *,
        modules: Sequence[Path] = (),
        keys: Path | None = None,
        variables_of: Callable[[RoleSpec], Mapping[str, str]] = lambda _: {},
    ) -> None:
        self._meeting, self._variables_of = meeting, variables_of
        self._modules = {path.name: path for path in modules}
        self._keys = {path.name: path.read_bytes() for path in sorted(keys.iterdir())} if keys is not None else {}
        self._placed: dict[str, _Placed] = {}
        self._clock = WallClock()
        self._ended: dict[str, RoleState] = {}
        connect(address)
        self._place = ray.remote(Place)

    def start(self, spec: RoleSpec) -> None:
        """See `Launcher.start`. A role waits for room; nothing is told of it meanwhile."""
        if spec.name in self._placed:
            raise Refused("role", where=spec.name, expected="one that does not run", got="one that does")
        luggage = Luggage(
            {name: self._module(name) for name in spec.modules}, self._keys, dict(self._variables_of(spec))
        )
        options = self._place.options(
            num_cpus=CPUS_OF.get(spec.kind, CPUS_OTHERWISE), max_restarts=0, max_task_retries=0, name=None
        )
        self._placed[spec.name] = _Placed(options.remote(self._meeting, spec, luggage))
        self._ended.pop(spec.name, None)

    def poll(self) -> dict[str, RoleState]:
        """See `Launcher.poll`."""
        now_s = self._clock.monotonic_s()
        over = {name: state for name, one in self._placed.items() if (state := one.look(now_s)).condition != "running"}
        _end([self._placed.pop(name) for name in over], LEAVE_S)
        self._ended |= over
        return {**{name: RoleState("running") for name in self._placed}, **self._ended}

    def drain(self, names: Collection[str]) -> None:
        """See `Launcher.drain`. An actor that waits for room asks the cluster for it no more."""
        chosen = [name for name in names if name in self._placed]
        waiting = [name for name in chosen if self._placed[name].waits]
        for name in set(chosen) - set(waiting):
            self._placed[name].actor.drain.remote()
        _drop([self._placed.pop(name) for name in waiting])
        self._ended |= {name: RoleState("finished", "there was no room for it yet") for name in waiting}

    def stop(self, names: Collection[str] | None = None) -> None:
        """See `Launcher.stop`."""
        chosen = set(self._placed) | set(self._ended) if names is None else set(names)
        ending = [self._placed.pop(name) for name in chosen if name in self._placed]
        late = _end(ending, STOP_WAIT_S)
        if late:
            log.warning("%d of %d roles do not stop; killed", late, len(ending))
        for name in chosen:
            self._ended.pop(name, None)

    def close(self) -> None:
        """Leave the cluster; one that was started here ends."""
        self.stop()
        ray.shutdown()

    def _module(self, name: str) -> bytes:
        if name not in self._modules:
            known = ", ".join(sorted(self._modules)) or "none"
            raise Refused("module", expected=f"one this launcher was given ({known})", got=repr(name))
        return self._modules[name].read_bytes()


def connect(address: str = "") -> int:
    """Join the cluster, or start one on this machine, without a dashboard (`runtime/on_ray.py` closes it to others).

    Returns how many cores it has. Harmless where this process has joined already.

    Raises:
        Unavailable: no cluster is reached.
    """
    if not ray.is_initialized():
        _knock(address)
        _begin(address)
    return int(ray.cluster_resources().get("CPU", 0))


def _knock(address: str) -> None:
    """Raise Unavailable at once where nobody listens: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), REACH_S).close()
    except (OSError, UnicodeError, OverflowError) as fault:
        raise Unavailable(f"no Ray cluster at {address}: {fault}") from fault


def _begin(address: str) -> None:
    try:
        if address:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            return
        ray.init(
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            object_store_memory=OBJECT_STORE_BYTES,
        )
    except (ConnectionError, RuntimeError, ValueError, RayError, GetTimeoutError) as fault:
        raise Unavailable(_unreached(address, _first_line(fault), environment("RAY_AUTH_MODE"))) from fault


def _unreached(address: str, why: str, auth_mode: str) -> str:
    """Return in words that a cluster was not reached; Ray itself says of a missing token only in its log."""
    if not address:
        return f"no Ray cluster on this machine: {why}"
    token = "" if auth_mode else "; where it asks for a token, as one of `ray start` does, set RAY_AUTH_MODE=token"
    return f"no Ray cluster at {address}: {why}{token}"


def _folder(name: str) -> tuple[Path, int]:
    """Return a new folder of mode 0700 for a role, and the lock on it: an open file, held while the actor lives."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=f"{FOLDERS}{name}-"))
        lock = _locked(folder)
        if lock < 0:
            continue  # another actor looks through the folders just now, and sweeps it
        if folder.is_dir():
            return folder, lock
        os.close(lock)


def _locked(folder: Path) -> int:
    """Return the lock on a folder, -1 where another holds it or there is none."""
    try:
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return -1
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return -1
    return lock


def _sweep() -> None:
    """Remove what actors of ours that were killed left on this node: keys and modules among it."""
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDERS}*"):
        lock = _locked(folder)
        if lock < 0:
            continue
        if os.fstat(lock).st_uid == os.geteuid():
            rmtree(folder, ignore_errors=True)
        os.close(lock)


def _unpacked(folder: Path, name: str, data: bytes) -> Path:
    folder.mkdir(mode=0o700, exist_ok=True)
    path = folder / Path(name).name
    path.touch(mode=0o600)
    path.write_bytes(data)
    return path


def _first_line(fault: Exception) -> str:
    lines = [line.strip() for line in str(fault).splitlines() if line.strip()]
    return lines[0][:300] if lines else type(fault).__name__
