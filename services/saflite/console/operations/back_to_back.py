"""Whether a build flies what a run flew as the run's own build did, rule or no rule.

Differential testing (McKeeman 1998): nobody has to say what the right flight would be. Noise alone sets flights apart,
so where the first flight on the build is another one it flies the test case under further noises: what the run's flight
shows counts as another way of flying only if it lies outside of what the build's own flights show.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from saflite.console.operations.builds import Bench, Build, Sample
from saflite.console.run_data.run_folder import RunFolder
from saflite.console.view.ci_files import Check, Outcome
from saflite.contract.bounds import Track
from saflite.contract.interval import wilson
from saflite.contract.plain import word
from saflite.contract.rng import derive
from saflite.contract.test_case import TestCase, stimulus_text
from saflite.contract.verdict import Judgement, Ruling
from saflite.contract.work import PolicyTexts

RULE = "flies-as-before"
TIMES = 4
"""Flights on the build where the first is another one than the run's, that one included."""

NEAR_M = 2.0
"""Tracks no farther apart than this at the same moment are alike."""

APART = " m apart"

State = Literal["equal", "alike", "varies", "differs", "not flown"]


class Seen(NamedTuple):
    """What is compared of a flight: how it ended, the states it went through, what each rule said, where it was."""

    ending: str
    states: tuple[str, ...]
    outcomes: dict[str, Ruling]
    track: Track


class Before(NamedTuple):
    """A first flight of a run."""

    name: str
    test_case: TestCase
    trace_digest: str
    seen: Seen


class Compared(NamedTuple):
    """What became of a test case on a build.

    `apart_m` is the greatest distance at the same moment from the nearest flight on the build, first beyond the limit
    at `from_s` (None: never).
    """

    before: Before
    state: State
    flights: int
    words: str = ""
    apart_m: float = 0.0
    from_s: float | None = None
    memory_safety: bool = False


def seen(ending: str, judgement: Judgement) -> Seen:
    """Return what is compared of a judged flight."""
    states = [judgement.transitions[0].before] if judgement.transitions else []
    for step in judgement.transitions:
        if step.after != states[-1]:
            states.append(step.after)
    return Seen(ending, tuple(states), {one.policy: one.outcome for one in judgement.verdicts}, judgement.track)


def flown_before(run: RunFolder, count: int | None, rng_seed: int) -> list[Before]:
    """Return first flights of the search that were judged: `count` of them drawn by lot, or all."""
    rows = [row for row in run.flights() if row.purpose == "search" and row.flight_index == 0]
    rows.sort(key=lambda row: float(derive(rng_seed, "compare", row.test_case).random()))
    found: list[Before] = []
    for row in rows:
        if count is not None and len(found) == count:
            break
        judgement = run.judgement(row.test_case)
        if judgement is not None:
            what = seen(row.ending, judgement)
            found.append(Before(row.test_case, run.test_case(row.test_case), row.trace_digest, what))
    return found


def compare(
    before: Sequence[Before],
    build: Build,
    policies: Sequence[str],
    texts: PolicyTexts,
    *,
    times: int,
    near_m: float,
    wall_limit_s: float,
) -> Iterator[Compared]:
    """Yield what became of each on the build, as it lands."""
    with Bench(build, wall_limit_s) as bench:
        for one in before:
            yield _compared(one, bench, policies, texts, times, near_m)


def _compared(
    one: Before, bench: Bench, policies: Sequence[str], texts: PolicyTexts, times: int, near_m: float
) -> Compared:
    samples = [bench.fly(one.test_case, policies, texts, 0)]
    if samples[0].judgement is not None and _differs_at_all(one, samples[0], near_m):
        samples += [bench.fly(one.test_case, policies, texts, noise) for noise in range(1, times)]
    return told(one, samples, near_m)


def _differs_at_all(one: Before, sample: Sample, near_m: float) -> bool:
    return told(one, [sample], near_m).state == "differs"


def told(one: Before, samples: Sequence[Sample], near_m: float) -> Compared:
    """Return what flights on a build say of a flight before, the first of them under the same noise.

    equal      bit by bit
    alike      ended, went through the same states and was ruled the same, no farther apart than `near_m`
    varies     not alike, but the build's own flights differ as much among themselves
    differs    it alone lies outside of what all the others show. Were all flights of one kind, each would be the one
               with the same chance: one in as many as there are
    not flown  the first flight says nothing of the vehicle
    """
    flown = [seen(sample.ending, sample.judgement) for sample in samples if sample.judgement is not None]
    memory = any(sample.memory_safety for sample in samples)
    if not flown or samples[0].judgement is None:
        return Compared(one, "not flown", 0, samples[0].message)
    if one.trace_digest and one.trace_digest == samples[0].trace_digest:
        return Compared(one, "equal", len(flown))
    apart_m, from_s = _nearest(one.seen, flown, near_m)
    if not _odd(one.seen, flown[:1], near_m):
        return Compared(one, "alike", len(flown), apart_m=apart_m)
    words = _odd(one.seen, flown, near_m)
    everyone = [one.seen, *flown]
    others_too = len(flown) > 1 and any(_odd(each, _without(everyone, each), near_m) for each in flown)
    if not words or others_too:
        return Compared(one, "varies", len(flown), "", apart_m, from_s, memory)
    text = "; ".join(words) + (_since(one.test_case, from_s) if words[-1].endswith(APART) else "")
    return Compared(one, "differs", len(flown), text, apart_m, from_s, memory)


def _without(flights: Sequence[Seen], one: Seen) -> list[Seen]:
    return [other for other in flights if other is not one]


def _odd(old: Seen, new: Sequence[Seen], near_m: float) -> list[str]:
    """Return in words in what all the other flights agree, and this one does not; the distance comes last."""
    before, after = old.outcomes, new[0].outcomes
    agreed = [
        policy
        for policy in sorted(before.keys() & after.keys())
        if before[policy] != after[policy] and len({one.outcomes.get(policy) for one in new}) == 1
    ]
    breaks = [policy for policy in agreed if after[policy] == "violated"]
    keeps = [policy for policy in agreed if before[policy] == "violated"]
    rest = len(agreed) - len(breaks) - len(keeps)
    words = [f"violates {', '.join(breaks)}"] if breaks else []
    words += [f"no longer violates {', '.join(keeps)}"] if keeps else []
    if len({one.ending for one in new}) == 1 and old.ending != new[0].ending:
        words.append(f"ends {new[0].ending}, was {old.ending}")
    if len({one.states for one in new}) == 1 and old.states != new[0].states:
        words.append(_first_unlike(old.states, new[0].states))
    words += [f"{rest} {'rule applies' if rest == 1 else 'rules apply'} in one and not in the other"] if rest else []
    apart_m = _nearest(old, new, near_m)[0]
    if apart_m > max(near_m, *(_nearest(one, _without(new, one), near_m)[0] for one in new)):
        words.append(f"{apart_m:.1f}{APART}")
    return words


def _first_unlike(old: tuple[str, ...], new: tuple[str, ...]) -> str:
    place = next((at for at, (one, other) in enumerate(zip(old, new, strict=False)) if one != other), None)
    at = min(len(old), len(new)) if place is None else place
    goes, went = (states[at] if at < len(states) else "nothing" for states in (new, old))
    return f"state {at + 1}: {goes}, was {went}"


def _nearest(old: Seen, new: Sequence[Seen], near_m: float) -> tuple[float, float | None]:
    """Return how far the nearest of the other flights is at most, and when it first is beyond the limit; 0 if alone."""
    return min((_far(old.track, other.track, near_m) for other in new), key=lambda pair: pair[0], default=(0.0, None))


def _far(one: Track, other: Track, near_m: float) -> tuple[float, float | None]:
    """Return the greatest distance of two tracks at the same moment, and when it first is beyond the limit."""
    if not one or not other:
        return 0.0, None
    first, second = np.array(one, dtype=np.float64), np.array(other, dtype=np.float64)
    upto_s = min(first[-1, 0], second[-1, 0])
    at_s = first[first[:, 0] <= upto_s, 0]
    if not at_s.size:
        return 0.0, None
    gaps = [np.interp(at_s, track[:, 0], track[:, axis]) for track in (first, second) for axis in (1, 2, 3)]
    far_m = np.sqrt(sum((gaps[axis] - gaps[axis + 3]) ** 2 for axis in range(3)))
    beyond = np.flatnonzero(far_m > near_m)
    return float(far_m.max()), float(at_s[beyond[0]]) if beyond.size else None


def _since(test_case: TestCase, from_s: float | None) -> str:
    """Return since when, and the input given last before."""
    if from_s is None:
        return ""
    given = [one for one in test_case.stimuli if one.at_s <= from_s]
    return f" from {from_s:.0f} s on" + (f", after {stimulus_text(given[-1])}" if given else "")


# ---- for people and scripts ---------------------------------------------------------------------------------------


def line(result: Compared) -> str:
    """Return a test case in one line."""
    words = f"  {word(result.words)}" if result.words else ""
    return f"{result.state:<9}  {result.before.name}{words}"


def plain(result: Compared) -> dict[str, object]:
    """Return it for scripts."""
    return {
        "test_case": result.before.name,
        "state": result.state,
        "flights": result.flights,
        "words": result.words,
        "apart_m": round(result.apart_m, 3),
        "from_s": result.from_s,
    }


def summary(results: Sequence[Compared], of: int, times: int) -> str:
    """Return all of them in one line, with the interval of the share that differs."""
    counts = {state: sum(1 for one in results if one.state == state) for state in _ORDER}
    text = ", ".join(f"{count} {_WORDS[state]}" for state, count in counts.items() if count)
    judged = len(results) - counts["not flown"]
    share = wilson(counts["differs"], judged)
    interval = "" if share.value is None else f"; share that differs {share.low:.2f} to {share.high:.2f}"
    chance = f"; of those that vary by chance about one in {times + 1} is told to differ" if counts["differs"] else ""
    return f"{len(results)} of {of} test cases: {text or 'none'}{interval}{chance}"


_WORDS: dict[State, str] = {
    "equal": "equal bit by bit",
    "alike": "alike",
    "varies": "vary by chance",
    "differs": "differ",
    "not flown": "not flown",
}
_ORDER = tuple(_WORDS)


def exit_code(results: Sequence[Compared]) -> int:
    """Return 1 where a flight differs, 3 where one could not be had, or none was."""
    if any(one.state == "differs" for one in results):
        return 1
    return 3 if not results or any(one.state == "not flown" for one in results) else 0


def check(result: Compared) -> Check:
    """Return it as a row for JUnit and SARIF; of memory safety no more than that."""
    outcomes: dict[State, Outcome] = {"differs": "failed", "not flown": "error"}
    words = "memory safety, withheld" if result.memory_safety else result.words
    return Check(
        rule=RULE,
        name=result.before.name,
        outcome=outcomes.get(result.state, "passed"),
        text=f"{result.state}: {words}" if words else result.state,
        level="warning",
        baseline="new" if result.state == "differs" else "unchanged",
        fingerprint=result.before.name,
        place="",
    )
