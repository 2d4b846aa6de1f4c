"""Which inputs the target takes in which mode, learnt from what flights answered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence

from saflite.contract.test_case import StimulusKind, TestCase
from saflite.contract.verdict import Transition

Key = tuple[StimulusKind, str]
UNKNOWN, DOUBT = 0.5, 2.0  # what the share of an input never given is taken for, and how many inputs that weighs


class Taken:
    """How often each input was given and taken in each mode of the target."""

    def __init__(self) -> None:
        self._given: Counter[tuple[Key, str]] = Counter()
        self._taken: Counter[tuple[Key, str]] = Counter()
        self._modes: dict[Key, set[str]] = {}

    def tell(
        self, case: TestCase, transitions: Sequence[Transition], given: Iterable[int], taken: Collection[int]
    ) -> None:
        """Learn from a flight: its steps, and the places of the inputs that were given, and of those taken."""
        begun = {step.stimulus: step.before for step in transitions if step.stimulus >= 0}
        left = {step.stimulus: step.after for step in transitions if step.stimulus >= 0}
        state = transitions[0].before if transitions else ""
        for place in sorted(given):
            stimulus = case.stimuli[place]
            mode = begun.get(place, state).partition(" ")[0]
            state = left.get(place, state)
            key = (stimulus.kind, stimulus.name)
            self._given[key, mode] += 1
            if place in taken:
                self._taken[key, mode] += 1
                self._modes.setdefault(key, set()).add(mode)

    def share(self, key: Key, mode: str) -> float:
        """Return in what share of the times it was given in a mode an input was taken."""
        return (self._taken[key, mode] + UNKNOWN * DOUBT) / (self._given[key, mode] + DOUBT)

    def given(self, key: Key, mode: str) -> int:
        """Return how often an input was given in a mode."""
        return self._given[key, mode]

    def best(self, key: Key) -> str:
        """Return the mode in which an input is taken most surely, empty where it never was."""
        return max(sorted(self._modes.get(key, ())), key=lambda mode: self.share(key, mode), default="")
