"""The launcher of this machine: one process per role, none left behind."""

from __future__ import annotations

import logging
import os
import re
import signal
import subprocess
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from saflite.contract.config import environment_with, own_python
from saflite.contract.endings import how_ended
from saflite.contract.errors import Refused, Unavailable
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.base import Condition, Meeting, RoleSpec, RoleState
from saflite.runtime.log_lines import event_of
from saflite.simulator_worker.processes import adopt_orphans, children, kill_strays, signal_group

log = logging.getLogger(__name__)

STOP_GRACE_S = 8.0
DRAIN_SIGNAL = signal.SIGUSR1  # its default action ends a worker that has not begun, and so holds nothing
TAIL_BYTES = 4096
_CONDITIONS: dict[int, Condition] = {
    0: "finished",
    2: "refused",
    3: "unavailable",
    4: "unanswered",
    5: "again",
    -DRAIN_SIGNAL: "finished",
    -signal.SIGKILL: "killed",
    -signal.SIGTERM: "killed",
}
_LOG_HEAD = re.compile(r"^\d{4}-\d\d-\d\d [\d:,]+ [A-Z] [\w.]+: ")

PrefixOf = Callable[[RoleSpec], Sequence[str]]
VariablesOf = Callable[[RoleSpec], Mapping[str, str]]


class LocalLauncher:
    """Roles as processes of this machine, each with a log and a spool below `folder`.

    Args:
        meeting: where the roles meet.
        folder: where logs and undelivered results go.
        run_dir: the run folder, for roles that need it; None where it lies on another machine.
        modules: files of modules from outside, known by the name of the file.
        keys: the farm's keys where it has a gate, otherwise what its roles prove themselves with.
        prefix_of: gives the words put before a role's command (a network namespace, a limit).
        variables_of: gives what is set in a role's environment, beside what is there.
    """

    def __init__(
        self,
        meeting: Meeting,
        folder: Path,
        *,
        run_dir: Path | None = None,
        modules: Sequence[Path] = (),
        keys: Path | None = None,
        prefix_of: PrefixOf = lambda _: (),
        variables_of: VariablesOf = lambda _: {},
    ) -> None:
        self._meeting, self._folder, self._run_dir, self._prefix_of = meeting, folder, run_dir, prefix_of
        self._variables_of, self._keys = variables_of, keys
        self._modules = {path.name: path for path in modules}
        self._clock = WallClock()
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._ended: dict[str, RoleState] = {}
        (folder / "logs").mkdir(parents=True, exist_ok=True)
        adopt_orphans()
        self._bystanders = set(children(os.getpid()))

    def start(self, spec: RoleSpec) -> None:
        """See `Launcher.start`."""
        if spec.name in self._running:
            raise Refused("role", where=spec.name, expected="one that does not run", got="one that does")
        command, variables = self._command(spec), environment_with(**self._variables_of(spec))
        with self._sink(spec.name) as sink:
            try:
                self._running[spec.name] = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=sink,
                    stderr=sink,
                    start_new_session=True,
                    env=variables,
                )
            except OSError as fault:
                raise Unavailable(f"{spec.name} cannot be started: {fault}") from fault
        self._ended.pop(spec.name, None)

    def poll(self) -> dict[str, RoleState]:
        """See `Launcher.poll`. Also ends whatever a role left behind when it died."""
        for name, process in list(self._running.items()):
            if process.poll() is not None:
                signal_group(process.pid, signal.SIGKILL)
                del self._running[name]
                self._ended[name] = self._state(name, process.returncode)
        kill_strays(self._bystanders | set(self.pids().values()))
        return {**dict.fromkeys(self._running, RoleState("running")), **self._ended}

    def drain(self, names: Collection[str]) -> None:
        """See `Launcher.drain`."""
        for process in [self._running[name] for name in names if name in self._running]:
            with suppress(ProcessLookupError):
                process.send_signal(DRAIN_SIGNAL)

    def stop(self, names: Collection[str] | None = None) -> None:
        """See `Launcher.stop`. What does not end within the grace is killed."""
        chosen = set(self._running) | set(self._ended) if names is None else set(names)
        running = [self._running.pop(name) for name in chosen if name in self._running]
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
        for name in chosen:
            self._ended.pop(name, None)
        kill_strays(self._bystanders | set(self.pids().values()))

    def pids(self) -> dict[str, int]:
        """Return the process ids of the roles that run; for tools of this machine."""
        return {name: process.pid for name, process in self._running.items()}

    def _command(self, spec: RoleSpec) -> list[str]:
        meeting = self._meeting
        command = [*self._prefix_of(spec), *own_python("saflite.runtime.serve"), spec.kind]
        command += [f"--campaign={meeting.campaign}", f"--worker={spec.name}", f"--parent={os.getpid()}"]
        command += [f"--listen={meeting.listen or meeting.connect}" if spec.listens else f"--connect={meeting.connect}"]
        command += [f"--gate={meeting.gate}"] if spec.listens and meeting.gate else []
        if self._keys is not None and bool(meeting.gate) == spec.listens:
            command += [f"--keys={self._keys}"]
        command += ["--insecure"] if meeting.insecure else []
        command += ["--json-logs"] if meeting.json_logs else []
        command += [f"--patience={meeting.patience_s}"] if meeting.patience_s else []
        command += [f"--label={label}={value}" for label, value in spec.labels.items()]
        command += [f"--spool={self._folder / 'spool' / spec.name}"]  # with `=`: a path may begin with a dash
        command += [f"--run-dir={self._run_dir}"] if self._run_dir is not None else []
        command += [f"--module={self._module(name)}" for name in spec.modules]
        return command

    def _module(self, name: str) -> Path:
        if name not in self._modules:
            known = ", ".join(sorted(self._modules)) or "none"
            raise Refused("module", expected=f"one this launcher was given ({known})", got=repr(name))
        return self._modules[name]

    def _sink(self, name: str) -> IO[bytes]:
        try:
            return self._log(name).open("ab")
        except OSError as fault:  # a full disk must not end the farm
            log.warning("no log for %s: %s", name, fault)
            return open(os.devnull, "wb")

    def _log(self, name: str) -> Path:
        return self._folder / "logs" / f"{name}.log"

    def _state(self, name: str, code: int) -> RoleState:
        """Return how a role ended. Only one that says itself why it ends has a last line that is the reason."""
        said, condition = self._last_words(name), _CONDITIONS.get(code, "broken")
        if code < 0 and condition != "finished":
            return RoleState(condition, f"process died: {how_ended(code)}")
        return RoleState(condition, f"{how_ended(code)}: {said}" if condition == "broken" else said)

    def _last_words(self, name: str) -> str:
        """Return the last line of a role's log, without time and place."""
        try:
            with self._log(name).open("rb") as file:
                file.seek(max(0, self._log(name).stat().st_size - TAIL_BYTES))
                lines = file.read().decode(errors="replace").split("\n")
        except OSError:
            return ""
        said = [line for line in lines if line.strip()]
        return event_of(_LOG_HEAD.sub("", said[-1])) if said else ""
