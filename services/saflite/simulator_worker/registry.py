"""Targets are found by their place: one module per target in `targets/`, an entry point, or a module file given.

What a target module offers stands in `contract/target.py`.
"""

from __future__ import annotations

import importlib
import logging
import pkgutil
import queue
import threading
from collections.abc import Callable, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import cast

import msgspec

from saflite.contract import wire
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.modules import OFFERED, given, load_file
from saflite.contract.target import TargetModule
from saflite.contract.target_info import TargetInfo
from saflite.simulator_worker import targets

log = logging.getLogger(__name__)

ENTRY_POINTS = "saflite.targets"
DESCRIBE_S = 20.0  # a target from outside that has not described itself by then is broken


@cache
def _installed() -> dict[str, EntryPoint]:
    """Return the entry points of installed packages; to look for them reads a file of each package there is."""
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)}


def target_names(files: Sequence[Path] = ()) -> tuple[str, ...]:
    """Return the names of all targets: by place, by entry point, and the module files given."""
    return tuple(sorted(_placed() | set(_installed()) | set(given("target")) | {path.stem for path in files}))


def load_target(name: str, files: Sequence[Path] = ()) -> TargetModule:
    """Return the target called `name`; raises Refused if there is none, two, or if its module is no target."""
    outside = {path.stem: path for path in files} | {key: module.path for key, module in given("target").items()}
    if name in outside:
        path = outside[name]
        if name in _placed():
            raise Refused("module", where=str(path), expected="a name no target of ours has", got=repr(name))
        return _as_target(load_file(path), str(path))
    if point := _installed().get(name):
        return _as_target(point.load(), point.value)
    if name not in target_names():
        fix = "one of your own is a file (--module FILE)"
        raise Refused("target", expected=f"one of {', '.join(target_names(files))}", got=repr(name), fix=fix)
    return _as_target(importlib.import_module(f"{targets.__name__}.{name}"), name)


def describe_target(name: str, files: Sequence[Path] = ()) -> TargetInfo:
    """Return what the target called `name` says of itself.

    Raises:
        Refused: there is no such target, its `describe` fails, does not end or returns no `TargetInfo`, or it gives
            itself another name.
        Unavailable: it cannot even tell on this machine.
    """
    info = _described(load_target(name, files), name)
    if info.name != name:
        raise Refused("target", where=name, expected=f"describe() of a target called {name!r}", got=repr(info.name))
    return info


def _described(target: TargetModule, name: str) -> TargetInfo:
    if name in _placed():
        return target.describe()  # ours: one that starts a binary limits each wait itself and says which was too long
    said = _said_in_time(target, name)
    if isinstance(said, Refused | Unavailable):
        raise said
    if isinstance(said, BaseException):
        raise Refused(
            "target", where=name, expected="describe() that answers", got=f"{type(said).__name__}: {said}"
        ) from said
    if not isinstance(said, TargetInfo):
        raise Refused("target", where=name, expected="describe() that returns a TargetInfo", got=type(said).__name__)
    try:
        return wire.convert(msgspec.to_builtins(said), TargetInfo)
    except (msgspec.ValidationError, TypeError) as fault:
        raise Refused("target", where=name, expected="describe() with fields of their types", got=str(fault)) from fault


def _said_in_time(target: TargetModule, name: str) -> object:
    """Return what `describe` of code from outside returned or raised, or that it did not end."""
    answers: queue.SimpleQueue[object] = queue.SimpleQueue()

    def ask() -> None:
        try:
            answers.put(target.describe())
        except BaseException as fault:  # noqa: BLE001  (code from outside: whatever it raises is told as its fault)
            answers.put(fault)

    threading.Thread(target=ask, name=f"describe {name}", daemon=True).start()
    try:
        return answers.get(timeout=DESCRIBE_S)
    except queue.Empty:
        return TimeoutError(f"no answer for {DESCRIBE_S:.0f} s")


def is_outside(name: str) -> bool:
    """Return whether a target is no part of this package."""
    return name not in _placed()


def _placed() -> set[str]:
    return {info.name for info in pkgutil.iter_modules(targets.__path__) if not info.name.startswith("_")}


def mavlink_server(name: str) -> Callable[..., None]:
    """Return what serves a target over MAVLink (`serve` of its module); raises Refused where it cannot be served."""
    serve = getattr(load_target(name), "serve", None)
    if serve is None:
        raise Refused("target", where=name, expected="one that can be served over MAVLink", got="one without serve()")
    return cast(Callable[..., None], serve)


def why_missing(name: str, files: Sequence[Path] = ()) -> str:
    """Return why the target cannot fly here, empty if it can."""
    try:
        return describe_target(name, files).missing
    except Unavailable as fault:
        return str(fault)


def builds_here(files: Sequence[Path] = ()) -> dict[str, str]:
    """Return the targets that can fly on this machine and the build of each; one that is broken is left out."""
    found = {}
    for name in target_names(files):
        try:
            info = describe_target(name, files)
        except Exception as fault:  # noqa: BLE001  (whatever ails one target, the others can fly)
            log.warning("target %s left out: %s: %s", name, type(fault).__name__, fault)
            continue
        if not info.missing:
            found[name] = info.build
    return found


def _as_target(module: ModuleType, where: str) -> TargetModule:
    lacking = [name for name in OFFERED["target"] if not callable(getattr(module, name, None))]
    if lacking:
        raise Refused(
            "target module", where=where, expected=f"functions {', '.join(OFFERED['target'])}", got=f"no {lacking[0]}"
        )
    return cast(TargetModule, module)
