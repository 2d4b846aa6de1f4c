"""Which of the scorer models asked for can be had here; the others are told, and what they would say is missing."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence

from saflite.contract.errors import Unavailable
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.model import Tools
from saflite.scorer_pool.registry import make


def unavailable(label: str) -> str:
    """Return why a model cannot be had, empty if it can (a server is asked for one answer); raises Refused."""
    clock = WallClock()

    def tools() -> Tools:
        return Tools(clock, lambda other: make(other, tools()))

    model = make(label, tools())
    try:
        model.warm(lambda: False)
    except Unavailable as fault:
        return str(fault)
    finally:
        model.close()
    return ""


def missing(labels: Sequence[str]) -> Mapping[str, str]:
    """Return the models that cannot be had and why, after saying so."""
    found = {label: why for label in dict.fromkeys(labels) if (why := unavailable(label))}
    for label, why in found.items():
        sys.stderr.write(f"missing, and counted as such: everything of {label}: {why}\n")
    return found


def told_models(labels: Iterable[str]) -> str:
    """Return the sentence of a page about the language models that were asked."""
    names = ", ".join(f"`{label}`" for label in sorted(labels))
    return f"Language models asked: {names} ([what that is](scorers.md))." if names else "No language model has a row."


def check_none(found: Mapping[str, str]) -> None:
    """Raise Unavailable if a model could not be had: what was asked for has not all been done."""
    if found:
        raise Unavailable(f"{', '.join(found)}: nothing was measured")
