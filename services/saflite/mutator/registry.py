"""Finds strategies by their place: one file each in `mutator/strategies`, or an entry point `saflite.strategies`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from importlib.metadata import entry_points
from typing import cast

from saflite.contract.errors import Refused
from saflite.mutator import strategies
from saflite.mutator.strategy import Options, Strategy

ENTRY_POINT_GROUP = "saflite.strategies"


@cache
def _outside() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=ENTRY_POINT_GROUP)}


@cache
def strategy_names() -> tuple[str, ...]:
    """Return the names of the strategies there are, sorted."""
    inside = {info.name for info in pkgutil.iter_modules(strategies.__path__)}
    return tuple(sorted(inside | set(_outside())))


def load_strategy(name: str) -> type[Strategy]:
    """Return the class of a strategy; raises Refused naming the ones there are."""
    if name not in strategy_names():
        fix = "see `saflite list strategies`"
        raise Refused("strategy", expected=f"one of {', '.join(strategy_names())}", got=repr(name), fix=fix)
    module = importlib.import_module(_outside().get(name, f"{strategies.__name__}.{name}").partition(":")[0])
    found = getattr(module, "Strategy", None)
    if found is None:
        raise Refused("strategy", expected=f"a class Strategy in the file of {name!r}", got="none")
    return cast(type[Strategy], found)


def describe(name: str) -> str:
    """Return the text a strategy is listed with: the docstring of its file."""
    return inspect.getdoc(importlib.import_module(load_strategy(name).__module__)) or ""


def options_of(name: str) -> Options:
    """Return the settings of a strategy with default, range and meaning."""
    return load_strategy(name).options
