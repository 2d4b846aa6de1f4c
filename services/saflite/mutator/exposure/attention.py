"""Which policies the next test cases are for: those attended least, those whose rule never spoke before others."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from saflite.contract.test_case import TestCase
from saflite.mutator.exposure.progress import APPLIED

Rng = np.random.Generator
SILENT, NEAR_MISS, FOUND = 1.3, 1.5, 0.25
"""How many times as much attention a policy gets whose rule never applied, that came close, that was broken before."""
NEAR = 0.8  # progress from which on a flight counts as a near miss
SUSPECTED = 3.0  # the same for one that a setting bears on which takes values outside its range
EASED = 8.0  # flights for a policy after which it gets a quarter of the attention: what a scorer passes over catches up
SPOKEN = 40.0  # flights in which its rule applied, asked for or not, after which it gets half
MARK, AT, BY = "for ", "@", "/"
_TIME = re.compile(r"\d{1,9}(\.\d{1,9})?")
_VARIANT = re.compile(r"\d{1,3}(-\d{1,3}\.\d{1,3})*")


class Span(NamedTuple):
    """A phase of a test case: the policy it was written for, when it begins (s), and by which variant of a procedure
    of the policy it goes, where it is a whole one.
    """

    policy: str
    from_s: float
    variant: str = ""


class Standing(NamedTuple):
    """What the flights so far made of one policy."""

    attended: int = 0
    applied: int = 0
    best: float = 0.0
    found: bool = False

    @property
    def weight(self) -> float:
        """Its share of the attention."""
        state = FOUND if self.found else SILENT if not self.applied else NEAR_MISS if self.best >= NEAR else 1.0
        return state / (1.0 + self.attended / EASED) ** 2 / (1.0 + self.applied / SPOKEN)


class Attention:
    """Standing of all policies of a campaign."""

    def __init__(self, policies: tuple[str, ...]) -> None:
        self._standing = {policy: Standing() for policy in policies}

    def tell(self, case: TestCase, progress: Mapping[str, float]) -> None:
        """Take what a flight said of each policy; its origin names those it was made for."""
        wanted = set(read_note(case.origin.note))
        for policy, old in self._standing.items():
            value = progress.get(policy)
            self._standing[policy] = Standing(
                attended=old.attended + (policy in wanted),
                applied=old.applied + (value is not None and value >= APPLIED),
                best=max(old.best, value if value is not None and value < 1.0 else 0.0),
                found=old.found or value == 1.0,
            )

    def rotation(self, rng: Rng, count: int, suspected: Collection[str] = ()) -> list[str]:
        """Return `count` policies in mixed order: each as often as its weight asks, to within one.

        Those `suspected` and not broken yet weigh more. Source: Kitagawa 1996, systematic resampling.
        """
        names = list(self._standing)
        edges = np.cumsum([self._weight(name, suspected) for name in names])
        places = (np.arange(count) + rng.random()) / count * edges[-1]
        drawn = np.minimum(np.searchsorted(edges, places, side="right"), len(names) - 1)
        return [names[place] for place in rng.permutation(drawn)]

    def _weight(self, name: str, suspected: Collection[str]) -> float:
        standing = self._standing[name]
        return standing.weight * (SUSPECTED if name in suspected and not standing.found else 1.0)


def note(policies: Iterable[str], how: str, spans: Iterable[Span] = ()) -> str:
    """Return the note of an origin: how a test case was made, for which policies, and when the phase of each began."""
    spans = tuple(spans)
    words = [f"{span.policy}{AT}{span.from_s:.2f}{BY * bool(span.variant)}{span.variant}" for span in spans]
    told = {span.policy for span in spans}
    return f"{how} {MARK}{' '.join([*words, *(one for one in dict.fromkeys(policies) if one not in told)])}"


def read_note(text: str) -> tuple[str, ...]:
    """Return the policies a note names."""
    return tuple(dict.fromkeys(word.partition(AT)[0] for word in _words(text)))


def read_spans(text: str) -> tuple[Span, ...]:
    """Return the phases a note tells of, in order: whose each was and when it began (s)."""
    return tuple(span for word in _words(text) if (span := _span(word)) is not None)


def _span(word: str) -> Span | None:
    policy, _, rest = word.partition(AT)
    from_s, _, variant = rest.partition(BY)
    if not _TIME.fullmatch(from_s):
        return None
    return Span(policy, float(from_s), variant if _VARIANT.fullmatch(variant) else "")


def _words(text: str) -> list[str]:
    _, mark, names = text.partition(f" {MARK}")
    return names.split() if mark else []
