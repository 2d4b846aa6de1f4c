"""Finds strategies by their place: one file each in `mutator/strategies`, or an entry point `saflite.strategies`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys
from functools import cache
from importlib.metadata import entry_points
from types import ModuleType
from typing import cast

from saflite.contract.errors import Refused
from saflite.contract.modules import given, load_file
from saflite.mutator import strategies
from saflite.mutator.strategy import Options, Strategy

ENTRY_POINT_GROUP = "saflite.strategies"


@cache
def _outside() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=ENTRY_POINT_GROUP)}


def strategy_names() -> tuple[str, ...]:
    """Return the names of the strategies there are, sorted."""
    return tuple(sorted(_placed() | set(_outside()) | set(given("strategy"))))


def load_strategy(name: str) -> type[Strategy]:
    """Return the class of a strategy; raises Refused naming the ones there are."""
    if name not in strategy_names():
        fix = "see `saflite list strategies`; one of your own is a file (--module FILE)"
        raise Refused("strategy", expected=f"one of {', '.join(strategy_names())}", got=repr(name), fix=fix)
    module = _module(name)
    found = getattr(module, "Strategy", None)
    if found is None:
        raise Refused("strategy", expected=f"a class Strategy in the file of {name!r}", got="none")
    return cast(type[Strategy], found)


def is_outside(name: str) -> bool:
    """Return whether a strategy is no part of this package."""
    return name not in _placed()


def describe(name: str) -> str:
    """Return the text a strategy is listed with: the docstring of its file."""
    return inspect.getdoc(sys.modules[load_strategy(name).__module__]) or ""


def options_of(name: str) -> Options:
    """Return the settings of a strategy with default, range and meaning."""
    return load_strategy(name).options


def _module(name: str) -> ModuleType:
    if name in given("strategy"):
        path = given("strategy")[name].path
        if name in _placed():
            raise Refused("module", where=str(path), expected="a name no strategy of ours has", got=repr(name))
        return load_file(path)
    return importlib.import_module(_outside().get(name, f"{strategies.__name__}.{name}").partition(":")[0])


def _placed() -> set[str]:
    return {info.name for info in pkgutil.iter_modules(strategies.__path__)}
