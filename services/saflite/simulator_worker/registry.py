"""Targets are found by their place: one module per target in `targets/`, an entry point, or a module file given.

What a target module offers stands in `contract/target.py`.
"""

from __future__ import annotations

import importlib
import logging
import pkgutil
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import cast

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.modules import OFFERED, given, load_file
from saflite.contract.target import TargetModule
from saflite.contract.target_info import TargetInfo
from saflite.simulator_worker import targets

log = logging.getLogger(__name__)

ENTRY_POINTS = "saflite.targets"


def target_names(files: Sequence[Path] = ()) -> tuple[str, ...]:
    """Return the names of all targets: by place, by entry point, and the module files given."""
    placed = {info.name for info in pkgutil.iter_modules(targets.__path__) if not info.name.startswith("_")}
    outside = {point.name for point in entry_points(group=ENTRY_POINTS)}
    return tuple(sorted(placed | outside | set(given("target")) | {path.stem for path in files}))


def load_target(name: str, files: Sequence[Path] = ()) -> TargetModule:
    """Return the target called `name`; raises Refused if there is none, or if its module is no target."""
    for path in files:
        if path.stem == name:
            return _as_target(load_file(path), str(path))
    if name in given("target"):
        path = given("target")[name].path
        return _as_target(load_file(path), str(path))
    for point in entry_points(group=ENTRY_POINTS, name=name):
        return _as_target(point.load(), point.value)
    if name not in target_names():
        raise Refused("target", expected=f"one of {', '.join(target_names(files))}", got=repr(name))
    return _as_target(importlib.import_module(f"{targets.__name__}.{name}"), name)


def describe_target(name: str, files: Sequence[Path] = ()) -> TargetInfo:
    """Return what the target called `name` says of itself.

    Raises:
        Refused: there is no such target, or it gives itself another name.
        Unavailable: it cannot even tell on this machine.
    """
    info = load_target(name, files).describe()
    if info.name != name:
        raise Refused("target", where=name, expected=f"describe() of a target called {name!r}", got=repr(info.name))
    return info


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
