"""Slots: what tells the simulators of one host apart, whichever farm of this user they fly for.

A slot is a lock file in a folder of this user's. The lock is held by the worker and by its simulator process, so the
kernel frees it when both are gone, however they went. Its ports lie below those the kernel hands out by itself (32768
and up); they are claimed by a name that belongs to the network, as ports do, so that no other slot of this host has
them, whichever folder or user it is of. Whoever claims all those names takes ports away from the slots, as he could by
binding the ports themselves, and no more: what needs none flies on.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import stat
from contextlib import suppress
from pathlib import Path

from saflite.contract.config import environment
from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external.place import left_outside, outside
from saflite.simulator_worker.messages import SlotInfo

SHARED = "/tmp/saflite"  # noqa: S108  (checked: ours, nobody else's)
SLOTS_MAX = 512
PORTS_FIRST, PORTS_EACH = 20_000, 20
_FIRST_PORTS = range(PORTS_FIRST, PORTS_FIRST + SLOTS_MAX * PORTS_EACH, PORTS_EACH)
LOCK_SUFFIX = ".lock"


def slots_folder() -> Path:
    """Return the folder of this user's slots: `SAFLITE_SLOTS`, or one that is the same for all farms of the host.

    Any user can make something of our name in `/tmp`: then it is one in the user's runtime directory or home.
    """
    given = environment("SAFLITE_SLOTS")
    shared = Path(f"{SHARED}-{os.getuid()}")
    if given or not _is_anothers(shared):
        return Path(given) if given else shared
    runtime = environment("XDG_RUNTIME_DIR")
    try:
        return (
            Path(runtime) if runtime else Path.home() / ".cache" / "saflite"
        ) / f"saflite-slots-{os.uname().nodename}"
    except RuntimeError:  # this user has no home
        return shared


class HeldSlot:
    """A slot that is ours until it is released or its holders' processes are gone."""

    def __init__(self, root: Path, index: int, lock: int) -> None:
        self._lock, self._root = lock, root
        try:
            first_port, self._claim = _claimed(index)
        except BaseException:
            os.close(lock)
            raise
        ports = PORTS_EACH if self._claim is not None else 0
        self.info = SlotInfo(index=index, folder=str(_folder(root, index)), first_port=first_port, ports=ports)
        self.empty()

    @property
    def files(self) -> tuple[int, ...]:
        """Descriptors that hold the slot for whoever has them open."""
        return (self._lock,) if self._claim is None else (self._lock, self._claim.fileno())

    def empty(self) -> None:
        """Leave nothing of earlier flights; raises Unavailable if the disk does not let us."""
        folder = Path(self.info.folder)
        shutil.rmtree(folder, ignore_errors=True)
        for path in self._outside():
            path.unlink(missing_ok=True)
        try:
            folder.mkdir(mode=0o700)
        except OSError as fault:
            raise Unavailable(f"folder of slot {self.info.index}: {fault}") from fault

    def _outside(self) -> tuple[Path, ...]:
        return outside(self.info.first_port) if self.info.ports else ()

    def release(self) -> None:
        """Give the slot back and leave no file behind; may be called twice."""
        if self._lock >= 0:
            for path in self._outside():
                path.unlink(missing_ok=True)
            _remove(self._root, self.info.index)
            os.close(self._lock)
            if self._claim is not None:
                self._claim.close()
            self._lock = -1
        with suppress(OSError):  # others may have slots there
            self._root.rmdir()


def take_slot(root: Path | None = None) -> HeldSlot:
    """Take the free slot with the lowest number, and clear away what dead holders of others left.

    Raises:
        Unavailable: all are taken, or their folder cannot be used.
    """
    place = root or slots_folder()
    for index in range(SLOTS_MAX):
        lock = _lock(place, index)
        if lock is not None:
            _sweep(place, index)
            return HeldSlot(place, index, lock)
    raise Unavailable(f"all {SLOTS_MAX} slots in {place} are taken")


def _sweep(root: Path, own: int) -> None:
    for path in root.glob(f"*{LOCK_SUFFIX}"):
        index = int(path.stem) if path.stem.isdigit() else own
        lock = None if index == own else _lock(root, index)
        if lock is not None:
            _remove(root, index)
            os.close(lock)
    for first_port, path in left_outside():
        if first_port not in _FIRST_PORTS:  # somebody's own autopilot, started by hand
            continue
        claim = _claim(first_port)
        if claim is not None:
            with claim, suppress(OSError):  # another user's
                path.unlink(missing_ok=True)


def _claimed(index: int) -> tuple[int, socket.socket | None]:
    """Return the first of the ports of a slot, and what claims them; (0, None) where others have all."""
    for number in (index, *range(SLOTS_MAX)):
        first_port = PORTS_FIRST + number * PORTS_EACH
        claim = _claim(first_port)
        if claim is not None:
            return first_port, claim
    return 0, None


def _claim(first_port: int) -> socket.socket | None:
    """Claim the ports from one on; None where another has."""
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0saflite-ports-{first_port}")  # a name without a file: the kernel frees it with its last holder
    except OSError:
        claim.close()
        return None
    return claim


def _lock(root: Path, index: int) -> int | None:
    """Return the open lock file of a slot, None if another holds it; raises Unavailable if there is no place for it."""
    path = _lock_file(root, index)
    while True:
        try:
            _make_private(root)
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except FileNotFoundError:  # the last holder removed the folder between our two steps
            continue
        except OSError as fault:
            raise Unavailable(f"slots in {root}: {fault}") from fault
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            return None
        if _is_still(path, lock):
            return lock
        os.close(lock)  # its holder released it, and so removed the file, while we waited to lock it


def _is_ours(root: Path) -> bool:
    """Return whether it is a folder of this user, no link, in which nobody else can write; raises OSError if gone."""
    found = root.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022


def _is_anothers(root: Path) -> bool:
    """Return whether there is something that is no folder of ours alone; its last holder may remove ours now."""
    try:
        return not _is_ours(root)
    except FileNotFoundError:
        return False
    except OSError:
        return True


def _make_private(root: Path) -> None:
    root.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    root.mkdir(mode=0o700, exist_ok=True)
    if not _is_ours(root):
        raise Unavailable(f"{root} is not a folder that only we may write to; set SAFLITE_SLOTS to another")


def _is_still(path: Path, lock: int) -> bool:
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    ours = os.fstat(lock)
    return (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino)


def _remove(root: Path, index: int) -> None:
    """Remove the files of a slot whose lock we hold."""
    shutil.rmtree(_folder(root, index), ignore_errors=True)
    _lock_file(root, index).unlink(missing_ok=True)


def _folder(root: Path, index: int) -> Path:
    return root / str(index)


def _lock_file(root: Path, index: int) -> Path:
    return root / f"{index}{LOCK_SUFFIX}"
