"""Which binary flies: the one a person names. It is known by its content; its path goes nowhere.

The autopilot is an external program; nothing of it is part of this package.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from saflite.contract.config import cache_root, environment, set_environment
from saflite.contract.errors import Refused, Unavailable

_LABELS = {"SAFLITE_ARDUPILOT": "ArduPilot", "SAFLITE_PX4": "PX4"}
_IN_BUILDS = "bin/px4", "bin/arducopter", "px4", "arducopter"
"""Where programs lie in the folder that their build makes."""

PROGRAM_BYTES_MAX = 2**30
"""Of a program, and of each file started beside it: builds with a sanitizer and all symbols have some 100 MB."""


class Binary(NamedTuple):
    """A binary that can fly here; `digest` is of all that is started of it, `version` what it says of itself.

    `state` is what `Binaries.state` was before that was read.
    """

    path: Path
    digest: str
    version: str
    state: int = 0


def _alone(path: Path) -> Iterable[Path]:
    return (path,)


class Binaries(NamedTuple):
    """How a person names the binaries of one autopilot.

    `target` is what they fly for, `label` the autopilot's name, `variable` of the environment holds the path, `wanted`
    says in words what to name; `look` tells what a file with content is, given its `state` (Refused where it cannot
    fly); `files` names the files that are started of a binary, itself among them.
    """

    target: str
    label: str
    variable: str
    wanted: str
    look: Callable[[Path, int], Binary]
    files: Callable[[Path], Iterable[Path]] = _alone

    def inspect(self, path: Path) -> Binary:
        """Return what a file is, without running it; raises Refused where it cannot fly."""
        try:
            found = path.resolve()
            state = found.stat()
            if not found.is_file() or state.st_size == 0:
                raise self._no_program(path, _kind(found), _meant(path))
            check_sizes(self.files(found))
            before = self.state(found)
            return self.look(found, before)._replace(state=before)
        except (FileNotFoundError, NotADirectoryError) as fault:
            raise self._no_program(path, "nothing there") from fault
        except OSError as fault:
            raise self._no_program(path, fault.strerror or str(fault)) from fault

    def state(self, path: Path) -> int:
        """Return a number that changes with any file that is started of a binary; none of them is read.

        Times of modification are no part of it: a build may be put in the place of another with the same.

        Raises:
            OSError: one is not there.
        """
        told = [(str(one), one.stat()) for one in self.files(path)]
        return hash(tuple((name, found.st_ctime_ns, found.st_size, found.st_ino) for name, found in told))

    def check_same(self, binary: Binary) -> None:
        """Raise Refused where a binary is no longer what it was; read again only where a file of it changed."""
        with suppress(OSError):
            if self.state(binary.path) == binary.state:
                return
        found = self.inspect(binary.path)
        if found.digest != binary.digest:
            raise Refused(
                f"binary of {self.label}",
                expected=f"the one that this session began with, SHA-256 {binary.digest[:12]}",
                got=f"another in its place, SHA-256 {found.digest[:12]}",
                fix="put that build back, or start again to fly the new one",
            )

    def _no_program(self, path: Path, got: str, meant: str = "") -> Refused:
        fix = "; ".join(filter(None, (meant, self.wanted)))
        return Refused("autopilot", where=str(path), expected="a program", got=got, fix=fix)

    def use(self, path: Path) -> None:
        """Have this process and those it starts fly with the binary in `path`; raises Refused as `inspect`."""
        self.inspect(path)
        set_environment(self.variable, str(path.resolve()))

    def named(self) -> Binary:
        """Return the binary named for this process.

        Raises:
            Unavailable: none is named, or it is gone.
            Refused: it cannot fly; see `inspect`.
        """
        place, how = environment(self.variable), f"name its simulator build: --autopilot PATH or {self.variable}=PATH"
        if not place:
            only = [label for name, label in _LABELS.items() if name != self.variable and environment(name)]
            but = f", only {only[0]}'s" if only else ""
            raise Unavailable(f"no {self.label} binary is named{but}; {how}")
        if not Path(place).is_file():
            raise Unavailable(f"{self.variable}: no file at {place}; {how}")
        return self.inspect(Path(place))

    def cache_folder(self) -> Path:
        """Return the folder of what this user's binaries said of themselves."""
        return cache_root() / self.target


def check_sizes(paths: Iterable[Path]) -> None:
    """Raise Refused where a file is too long: all of them are read. OSError: one is not there."""
    for path in paths:
        size = path.stat().st_size
        if size > PROGRAM_BYTES_MAX:
            expected = f"files of at most {PROGRAM_BYTES_MAX} bytes"
            raise Refused("autopilot", where=str(path), expected=expected, got=f"{size} bytes")


def check_runnable(path: Path) -> None:
    """Raise Refused where this user may not run a file."""
    if not os.access(path, os.X_OK):
        fix = f"chmod +x {shlex.quote(str(path))}"
        raise Refused("autopilot", where=str(path), expected="leave to run it", got="none", fix=fix)


def _kind(path: Path) -> str:
    """Return in words what lies at a path that is no file with content."""
    return "a folder" if path.is_dir() else "an empty file" if path.is_file() else "something else than a file"


def _meant(folder: Path) -> str:
    """Return the advice to name the program in a build folder, empty where none lies there."""
    found = [folder / name for name in _IN_BUILDS if (folder / name).is_file()]
    return f"did you mean {shlex.quote(str(found[0]))}?" if found else ""
