"""Finds export formats by their place: one file each in `recorder/exports`, or an entry point `saflite.exports`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from saflite.contract.errors import Refused
from saflite.recorder import exports
from saflite.recorder.summary import RunSummary

ENTRY_POINT_GROUP = "saflite.exports"


@cache
def _modules() -> dict[str, ModuleType]:
    places = {info.name: f"{exports.__name__}.{info.name}" for info in pkgutil.iter_modules(exports.__path__)}
    places |= {point.name: point.value.partition(":")[0] for point in entry_points(group=ENTRY_POINT_GROUP)}
    return {name: importlib.import_module(place) for name, place in sorted(places.items())}


def format_names() -> tuple[str, ...]:
    """Return the names of the formats there are, sorted; other names for the same format come last."""
    modules = _modules()
    aliases = (alias for module in modules.values() for alias in getattr(module, "ALIASES", ()))
    return (*modules, *sorted(aliases))


def describe(name: str) -> str:
    """Return the text a format is listed with: the docstring of its file."""
    return inspect.getdoc(_module(name)) or ""


def export(name: str, summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write the campaign's result in a format; returns the files written.

    Raises:
        Refused: there is no such format.
        Unavailable: the disk does not take it.
    """
    written: tuple[Path, ...] = _module(name).export(summary, folder)
    return written


def _module(name: str) -> ModuleType:
    for known, module in _modules().items():
        if name == known or name in getattr(module, "ALIASES", ()):
            return module
    raise Refused("export format", expected=f"one of {', '.join(format_names())}", got=repr(name))
