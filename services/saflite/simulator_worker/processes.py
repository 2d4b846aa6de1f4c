"""Process housekeeping on Linux: children that die with their parent, groups that are killed whole, no orphans."""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel kill this process when its parent dies; ends at once if `parent_pid` is gone already."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:
        os._exit(0)


def adopt_orphans() -> None:
    """Become the parent of every descendant whose own parent dies, so that `kill_strays` finds it."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _prctl(option: int, value: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")


def identity(pid: int) -> str:
    """Return what tells a process from all others that ever bear its number, elsewhere or later; empty for none.

    That is the boot, the namespace its number belongs to, and when it began: the same from two places only where both
    see the same process under the number.
    """
    try:
        began = _after_name(pid)[19]
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')} {began}"
    except OSError:
        return ""


def _after_name(pid: int) -> list[str]:
    """Return what the kernel says of a process behind its name, which may be any bytes; raises OSError."""
    return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()


def children(pid: int) -> list[int]:
    """Return the child processes of `pid`, dead but unreaped ones included."""
    found: list[int] = []
    with suppress(OSError):  # it is gone, or a thread of it is
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(OSError):
                found += [int(word) for word in (task / "children").read_text().split()]
    return found


def _family(pid: int) -> Iterator[int]:
    """Yield a process and its descendants, however deep: programs of others may start theirs in a chain."""
    waiting = [pid]
    while waiting:
        waiting += children(one := waiting.pop())
        yield one


def resident_mib(pid: int) -> float:
    """Return the memory of a process and its descendants held in RAM, in MiB; 0 for a process that is gone.

    Pages that processes share count once between them: a fork that only waits costs next to nothing.
    """
    return round(sum(map(_own_kib, _family(pid))) / 1024, 1)


def _own_kib(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def processor_s(pid: int) -> float:
    """Return the processor time of a process, its descendants and those it has reaped, seconds; 0 for one that is gone.

    That of a descendant killed and reaped by somebody else is lost.
    """
    return round(sum(map(_own_ticks, _family(pid))) / os.sysconf("SC_CLK_TCK"), 2)


def _own_ticks(pid: int) -> int:
    try:
        return sum(map(int, _after_name(pid)[11:15]))  # user, system, both of the reaped
    except OSError:
        return 0


def starved_s(pid: int) -> float:
    """Return how long a process, or the descendant of which it is more, was ready to run and had no core, seconds.

    0 for one that is gone, or where the kernel does not count it (`schedstat`, second field).
    """
    return max(map(_own_starved_s, _family(pid)))


def _own_starved_s(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
    except (OSError, IndexError):
        return 0.0


def signal_group(group: int, number: signal.Signals) -> None:
    """Send a signal to every process of a group; none being left is fine."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def kill_strays(known: Collection[int]) -> list[int]:
    """Kill and reap every child of this process not in `known`, with whatever it started; return whom it killed.

    Only sees what `adopt_orphans` brought here: a child of ours keeps its id until we reap it, so none is mistaken.
    Those that had ended by themselves, and only wait for somebody to take leave of them, are reaped and not returned.
    """
    killed: list[int] = []
    while strays := [pid for pid in children(os.getpid()) if pid not in known]:
        for pid in strays:
            with suppress(ChildProcessError):
                if os.waitpid(pid, os.WNOHANG)[0]:
                    continue
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            with suppress(ChildProcessError):
                os.waitpid(pid, 0)
            killed.append(pid)
    return killed


@contextmanager
def no_strays() -> Iterator[None]:
    """Kill in the end what was started inside and is not reaped yet, whatever session it has made for itself.

    For a process that starts nothing else meanwhile: whatever is not there before counts as started inside.
    """
    adopt_orphans()
    bystanders = set(children(os.getpid()))
    try:
        yield
    finally:
        kill_strays(bystanders)
