"""Which of several builds in order broke a test case, or fixed it: a search that allows for flaky violations.

Each flight goes to the build that is expected to tell most (`chances.most_telling`); the search ends when one answer is
likely enough. A build that cannot be flown is left out, and told if the change may lie in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from saflite.console.operations import chances
from saflite.console.operations.builds import FRESH_NOISE, Benches, Build, Sample
from saflite.console.operations.chances import Change, Count
from saflite.console.run_data.known import Known

LOST_MAX = 2
"""Flights in a row that say nothing, after which a build is left out."""

Fly = Callable[[int, int], Sample]
"""(build, how many flights it had) -> a flight of it."""


class Bisected(NamedTuple):
    """What was found: `change` at `place` (the first build that differs), with its chance; flights of each build.

    `left_out` says why, by build.
    """

    change: Change
    place: int
    chance: float
    counts: tuple[Count, ...]
    lost: tuple[int, ...]
    left_out: dict[int, str]
    sure: bool

    @property
    def before(self) -> int:
        """The last build before the change that was flown."""
        return max((at for at in range(self.place) if at not in self.left_out), default=0)

    @property
    def between(self) -> list[int]:
        """The builds left out among which the change may lie."""
        return [at for at in range(self.before + 1, self.place) if at in self.left_out]

    @property
    def flights(self) -> int:
        """Flights flown, lost ones included."""
        return sum(judged for _, judged in self.counts) + sum(self.lost)


def bisect(known: Known, builds: Sequence[Build], *, confidence: float, most: int, wall_limit_s: float) -> Bisected:
    """Fly the test case on the builds until one answer has `confidence`, or `most` flights were flown.

    The noises are none of those by which it was found: on the build of the record these were chosen to violate.
    """
    policies = tuple(dict.fromkeys((known.policy, *known.policies)))
    with Benches(wall_limit_s) as benches:

        def fly(at: int, number: int) -> Sample:
            bench = benches.of(builds[at])
            return bench.fly(known.test_case, policies, known.policy_texts, FRESH_NOISE + number)

        return search(fly, known.policy, len(builds), confidence=confidence, most=most)


def search(fly: Fly, policy: str, builds: int, *, confidence: float, most: int) -> Bisected:
    """Search `builds` builds by `fly`; see `bisect`."""
    counts: list[Count] = [(0, 0)] * builds
    lost, in_a_row, left_out = [0] * builds, [0] * builds, dict[int, str]()
    while True:
        usable = [at for at in range(builds) if at not in left_out]
        belief = chances.believe([counts[at] for at in usable]) if usable else None
        flown = sum(judged for _, judged in counts) + sum(lost)
        best, chance = belief.best if belief is not None else (chances.Hypothesis("never", 0), 0.0)
        if belief is None or chance >= confidence or flown >= most:
            place = usable[best.place] if usable else 0
            told = tuple(counts), tuple(lost), left_out
            return Bisected(best.change, place, chance, *told, chance >= confidence)
        at = usable[chances.most_telling([counts[at] for at in usable], belief)]
        sample = fly(at, counts[at][1] + lost[at])
        verdict = sample.of(policy)
        if verdict is None:
            lost[at], in_a_row[at] = lost[at] + 1, in_a_row[at] + 1
            if in_a_row[at] >= LOST_MAX:
                left_out[at] = sample.message or "its flights could not be judged"
            continue
        in_a_row[at] = 0
        counts[at] = (counts[at][0] + (verdict.outcome == "violated"), counts[at][1] + 1)


def exit_code(found: Bisected) -> int:
    """Return 1 where a build broke it or it always was, 0 where it is fixed or never was, 3 where nobody can say."""
    if not found.sure:
        return 3
    return int(found.change in ("broke", "always"))


def lines(found: Bisected, builds: Sequence[Build], known: Known) -> list[str]:
    """Return the result in words: each build's flights, the answer with its chance."""
    rows = []
    for at, build in enumerate(builds):
        hits, judged = found.counts[at]
        lost = f", {found.lost[at]} lost" if found.lost[at] else ""
        words = f"left out: {found.left_out[at]}" if at in found.left_out else f"violated in {hits} of {judged}{lost}"
        rows.append(f"  {at + 1}. {build.label}  build {build.digest[:12]}  {words}")
    return [f"{known.policy}, test case {known.name}, {found.flights} flights:", *rows, _answer(found, builds)]


def _answer(found: Bisected, builds: Sequence[Build]) -> str:
    sure = f"probability {found.chance:.3f}" + ("" if found.sure else ", not enough: allow more flights")
    if not any(judged for _, judged in found.counts):
        return "no build could be flown: nothing can be said"
    if found.change in ("never", "always"):
        words = "violated on none of the builds" if found.change == "never" else "violated on all of the builds"
        return f"{words} ({sure})"
    between = ", ".join(builds[at].label for at in found.between)
    also = f", or in {between}, which could not be flown" if between else ""
    return f"{found.change} in {builds[found.place].label}, after {builds[found.before].label}{also} ({sure})"


def plain(found: Bisected, builds: Sequence[Build]) -> dict[str, Any]:
    """Return the result for scripts."""
    changed = found.change in ("broke", "fixed")
    return {
        "change": found.change,
        "sure": found.sure,
        "probability": found.chance,
        "first": builds[found.place].label if changed else "",
        "last_before": builds[found.before].label if changed else "",
        "may_be_in": [builds[at].label for at in found.between] if changed else [],
        "builds": [
            {
                "build": build.label,
                "digest": build.digest,
                "violated": found.counts[at][0],
                "judged": found.counts[at][1],
                "lost": found.lost[at],
                "left_out": found.left_out.get(at, ""),
            }
            for at, build in enumerate(builds)
        ],
    }
