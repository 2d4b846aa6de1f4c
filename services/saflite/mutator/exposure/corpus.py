"""Flights worth changing: per policy the one that came furthest unbroken, and those that covered new steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec
import numpy as np

from saflite.contract.bounds import Count, Share
from saflite.contract.errors import Refused
from saflite.contract.test_case import Scenario, Stimulus, TestCase, draw_key, identity
from saflite.contract.wire import UNREADABLE, unpack_json

Rng = np.random.Generator
COVERING_MAX = 48
PATIENCE = 0.02  # an entry counts as this much less far for every child that came no further


class Entry(NamedTuple):
    """One flight that is kept."""

    scenario: Scenario
    stimuli: tuple[Stimulus, ...]
    identity: str
    draw_key: str
    progress: float


class Sown(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An entry as the setting `corpus` holds it: how far it came for which policies, how many steps it covered."""

    scenario: Scenario
    stimuli: tuple[Stimulus, ...]
    progress: dict[str, Share] = {}
    new: Count = 0


def read_sown(texts: list[str]) -> tuple[Sown, ...]:
    """Return the entries in the setting `corpus`; raises Refused for a text that is none."""
    try:
        return tuple(unpack_json(text, Sown) for text in texts)
    except UNREADABLE as fault:
        raise Refused("strategy setting corpus", expected="entries of a corpus as JSON", got=str(fault)) from fault


class Corpus:
    """The best of every policy, and the latest that covered something new."""

    def __init__(self) -> None:
        self._best: dict[str, Entry] = {}
        self._covering: dict[str, Entry] = {}
        self._in_vain: dict[str, int] = {}

    def tell(self, case: TestCase, progress: Mapping[str, float], new: int) -> None:
        """Keep a flight that is the best of a policy or covered `new` steps; one that broke a rule is done with."""
        gained = False
        for policy, value in progress.items():
            held = self._best.get(policy)
            if value >= 1.0 or (held is not None and value <= self._worth(held)):
                continue
            gained = gained or held is None or value > held.progress
            self._best[policy] = _entry(case, value)
        if new and max(progress.values(), default=0.0) < 1.0:
            self._covering[identity(case)] = _entry(case, float(new))
            if len(self._covering) > COVERING_MAX:
                least = min(self._covering.values(), key=lambda entry: (entry.progress, entry.draw_key))
                del self._covering[least.identity]
        if case.origin.parent and not gained and not new:
            self._in_vain[case.origin.parent] = self._in_vain.get(case.origin.parent, 0) + 1

    def _worth(self, entry: Entry) -> float:
        return entry.progress - PATIENCE * self._in_vain.get(entry.identity, 0)

    def sown(self) -> list[str]:
        """Return what is kept as texts for the setting `corpus`, in the order of their draw keys."""
        entries = {entry.identity: entry for entry in (*self._best.values(), *self._covering.values())}
        texts = []
        for entry in sorted(entries.values(), key=lambda one: one.draw_key):
            reached = {name: one.progress for name, one in self._best.items() if one.identity == entry.identity}
            covered = self._covering.get(entry.identity)
            new = int(covered.progress) if covered else 0
            kept = Sown(scenario=entry.scenario, stimuli=entry.stimuli, progress=reached, new=new)
            texts.append(msgspec.json.encode(kept, order="deterministic").decode())
        return texts

    def best(self, policy: str) -> Entry | None:
        """Return the flight that came furthest for a policy."""
        return self._best.get(policy)

    def covering(self, rng: Rng) -> Entry | None:
        """Return a flight that covered something, those that covered more rather; None if there is none."""
        entries = sorted(self._covering.values(), key=lambda entry: (-entry.progress, entry.draw_key))
        return entries[int(len(entries) * rng.random() ** 2)] if entries else None

    def any(self, rng: Rng) -> Entry | None:
        """Return any flight kept."""
        entries = {entry.identity: entry for entry in (*self._best.values(), *self._covering.values())}
        ordered = sorted(entries.values(), key=lambda entry: entry.draw_key)
        return ordered[int(rng.integers(len(ordered)))] if ordered else None


def _entry(case: TestCase, progress: float) -> Entry:
    return Entry(case.scenario, case.stimuli, identity(case), draw_key(case), progress)
