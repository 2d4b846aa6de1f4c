"""Which input is drawn: a kind first, then a name by what is known and learnt of its relevance to a policy."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from saflite.contract.test_case import StimulusKind, TestCase
from saflite.mutator.exposure.hints import Hint
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.operators.inputs import Have, Input

Rng = np.random.Generator
Item = TypeVar("Item")
Key = tuple[StimulusKind, str]
AT_ONCE: tuple[StimulusKind, ...] = ("command", "mode", "sensor_fault", "stick")
ENDS = ("MAV_CMD_DO_FLIGHTTERMINATION", "MAV_CMD_DO_PARACHUTE", "MAV_CMD_COMPONENT_ARM_DISARM")
TRUST = 4.0
"""Flights with an input after which what was seen weighs as much as the mean of all flights."""
REFUSED_LEAST = 0.1
READ_SHARE = 0.3  # of a policy's own inputs, those whose values its formula reads
OF_MODE = 8.0  # how much oftener a setting is drawn in the mode that it is named after: RTL_ALT_FINAL in RTL
STEM_LEAST = 3  # letters of a mode's name that a setting's begins with: LOIT_SPEED is of LOITER
SHARPNESS = 4.0
"""Power of the learnt ratio: an input whose flights came 20 % further is drawn twice as often."""


class Seen(NamedTuple):
    """Flights with an input and the sum of their progress."""

    flights: int = 0
    progress: float = 0.0

    def more(self, progress: float) -> Seen:
        """Return it with one more flight."""
        return Seen(self.flights + 1, self.progress + progress)


class Vocabulary:
    """All inputs of the target by kind, and per policy how far the flights with each input came."""

    def __init__(self, have: Have, taken: Taken) -> None:
        """Take the inputs, and what is known of where they are taken."""
        self._taken = taken
        self._by_kind: dict[StimulusKind, tuple[Input, ...]] = {}
        for kind in sorted({kind for kind, _ in have}):
            self._by_kind[kind] = tuple(entry for (other, _), entry in have.items() if other == kind)
        self._seen: dict[str, dict[Key, Seen]] = defaultdict(dict)
        self._all: dict[str, Seen] = {}
        self._refused: dict[Key, int] = {}  # times given and refused, -1 once it was taken

    @property
    def kinds(self) -> tuple[StimulusKind, ...]:
        """The kinds there are, sorted."""
        return tuple(self._by_kind)

    def tell(self, case: TestCase, progress: Mapping[str, float], given: Iterable[int], taken: Collection[int]) -> None:
        """Learn how far a flight with these inputs came for every policy; inputs by place: all given, those taken."""
        for place in sorted(given):
            key = (case.stimuli[place].kind, case.stimuli[place].name)
            if place in taken or self._refused.get(key, 0) < 0:
                self._refused[key] = -1
            else:
                self._refused[key] = self._refused.get(key, 0) + 1
        keys = sorted({(case.stimuli[place].kind, case.stimuli[place].name) for place in taken})
        for policy, value in progress.items():
            self._all[policy] = self._all.get(policy, Seen()).more(value)
            seen = self._seen[policy]
            for key in keys:
                seen[key] = seen.get(key, Seen()).more(value)

    def relevance(self, policy: str, key: Key) -> float:
        """Return how much further flights with an input came for a policy than the mean flight, 1 for no farther."""
        every = self._all.get(policy)
        seen = self._seen[policy].get(key) if policy in self._seen else None
        mean = every.progress / every.flights if every is not None else 0.0
        if seen is None or mean <= 0.0:
            return 1.0
        return float((seen.progress + TRUST * mean) / ((seen.flights + TRUST) * mean))

    def _weight(self, policy: str, entry: Input, mode: str) -> float:
        """What was always refused is drawn less, down to a tenth: it says nothing. So is what this mode refuses."""
        refused = max(0, self._refused.get((entry.kind, entry.name), 0))
        heard = max(REFUSED_LEAST, 2.0 / (2.0 + refused))
        if mode and entry.kind in ("command", "mode"):
            heard *= max(REFUSED_LEAST, self._taken.share((entry.kind, entry.name), mode))
        elif entry.kind == "parameter" and _named_after(entry.name, mode):
            heard *= OF_MODE
        return heard * math.pow(self.relevance(policy, (entry.kind, entry.name)), SHARPNESS)

    def draw(self, rng: Rng, policy: str, kinds: Sequence[StimulusKind], mode: str = "") -> Input:
        """Return any input of the target: its kind evenly among `kinds`, its name by learnt relevance."""
        kind = kinds[int(rng.integers(len(kinds)))]
        entries = self._by_kind[kind]
        return pick(rng, entries, [self._weight(policy, entry, mode) for entry in entries])

    def draw_seldom(self, rng: Rng, mode: str) -> Input | None:
        """Return an input that was given seldom in a mode, its kind evenly among those that act at once.

        What may end a flight is left out, and so are settings: most of what there are change nothing that shows.
        """
        kinds = [kind for kind in AT_ONCE if kind in self._by_kind]
        kind = kinds[int(rng.integers(len(kinds)))] if kinds else None
        entries = [entry for entry in self._by_kind.get(kind, ()) if entry.name not in ENDS] if kind else []
        return pick(rng, entries, [self._novelty(entry, mode) for entry in entries]) if entries else None

    def _novelty(self, entry: Input, mode: str) -> float:
        """Return less the oftener an input was given in a mode, and where it was refused there."""
        key: Key = (entry.kind, entry.name)
        return max(REFUSED_LEAST, self._taken.share(key, mode)) / (1 + self._taken.given(key, mode))

    def draw_own(self, rng: Rng, hint: Hint, kinds: Iterable[StimulusKind], mode: str = "") -> Input | None:
        """Return an input the policy reads, or of its own list; None if it has none of these kinds."""
        every = hint.read if hint.read and rng.random() < READ_SHARE else hint.inputs
        mine = sorted({entry.kind for entry in every if entry.kind in set(kinds)})
        if not mine:
            return None
        kind = mine[int(rng.integers(len(mine)))]
        entries = [entry for entry in every if entry.kind == kind]
        return pick(rng, entries, [self._weight(hint.policy, entry, mode) for entry in entries])


def _named_after(setting: str, mode: str) -> bool:
    stem = setting.partition("_")[0]
    return len(stem) >= STEM_LEAST and mode.startswith(stem)


def pick(rng: Rng, entries: Sequence[Item], weights: Sequence[float]) -> Item:
    """Return one of the entries with a chance proportional to its weight."""
    edges = np.cumsum(weights)
    place = int(np.searchsorted(edges, rng.random() * edges[-1], side="right"))
    return entries[min(place, len(entries) - 1)]
