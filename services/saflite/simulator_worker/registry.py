"""Targets are found by their place: one module per target in `targets/`, or a module file named on the command line.

A target module holds

    describe() -> TargetInfo                      what it says of itself; raises Unavailable where it cannot even tell
    fly(test_case, cancelled) -> FlightRecord     fly once; raises Refused (bad input) or Unavailable (bring-up failed)
    check(test_case) -> None                      raise Refused where this target cannot fly the test case
    missing() -> str                              optional: why it cannot fly on this machine, empty if it can
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Protocol, cast

from saflite.contract.errors import Refused
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.simulator_worker import targets

ENTRY_POINTS = "saflite.targets"


class TargetModule(Protocol):
    """What a target module offers."""

    def describe(self) -> TargetInfo:
        """Say what the target is and can do."""
        ...

    def fly(self, test_case: TestCase, cancelled: Cancelled) -> FlightRecord:
        """Fly once."""
        ...

    def check(self, test_case: TestCase) -> None:
        """Raise Refused where the test case cannot be flown."""
        ...


def target_names(files: Sequence[Path] = ()) -> tuple[str, ...]:
    """Return the names of all targets: by place, by entry point, and the module files given."""
    placed = {info.name for info in pkgutil.iter_modules(targets.__path__) if not info.name.startswith("_")}
    outside = {point.name for point in entry_points(group=ENTRY_POINTS)}
    return tuple(sorted(placed | outside | {path.stem for path in files}))


def load_target(name: str, files: Sequence[Path] = ()) -> TargetModule:
    """Return the target called `name`; raises Refused if there is none."""
    for path in files:
        if path.stem == name:
            return cast(TargetModule, _load_file(path))
    for point in entry_points(group=ENTRY_POINTS, name=name):
        return cast(TargetModule, point.load())
    if name not in target_names():
        raise Refused("target", expected=f"one of {', '.join(target_names(files))}", got=repr(name))
    return cast(TargetModule, importlib.import_module(f"{targets.__name__}.{name}"))


def describe_target(name: str, files: Sequence[Path] = ()) -> TargetInfo:
    """Return what a target says of itself.

    Raises:
        Refused: there is no such target, or its module does not describe it.
        Unavailable: it cannot even tell on this machine.
    """
    module = load_target(name, files)
    if not hasattr(module, "describe"):
        raise Refused("target module", where=name, expected="a function describe()", got="none")
    return module.describe()


def flyable(files: Sequence[Path] = ()) -> tuple[str, ...]:
    """Return the names of the targets that can fly on this machine."""
    return tuple(name for name in target_names(files) if not why_missing(load_target(name, files)))


def why_missing(target: TargetModule) -> str:
    """Return why the target cannot fly here, empty if it can."""
    missing = getattr(target, "missing", None)
    return str(missing()) if missing is not None else ""


def _load_file(path: Path) -> ModuleType:
    name = f"saflite_target_{path.stem}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise Refused("target module", where=str(path), expected="a Python file", got="none")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
