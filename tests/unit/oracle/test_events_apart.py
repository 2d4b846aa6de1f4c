"""Every policy is judged by what the page on time says where two of its events come 0, 1 or 2 samples apart.

Its examples are the flights. A signal that is no measurement changes and changes back 1 or 2 samples later; of two such
signals, the change of one is moved to the change of the other (or made there, where it never changes). 0 apart there
are three ways: both in one sample, and each first, as a target tells that knows the order. What the page says is worked
out one moment at a time (`by_definition.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, permutations, product

import numpy as np
import pytest
from by_definition import Definition

from saflite.oracle.examples import completed, example_signals
from saflite.oracle.finding import find
from saflite.oracle.formula import parts, signals_of
from saflite.oracle.policy import Policy, load_policy, policy_names, signal_table
from saflite.oracle.stl import Evaluator
from saflite.oracle.windows import Array

PAIRS_MAX, SAMPLES_MAX = 3, 300
Signals = dict[str, Array]
Case = tuple[Signals, list[int], float, str]


def flights(policy: Policy, name: str) -> list[tuple[Signals, float]]:
    """Return the examples of a policy, the shortest first."""
    found, table = [], signal_table(policy.file)
    for number in range(1, len(policy.file.examples) + 1):
        example = completed(policy.file.examples, number, name)
        signals = example_signals(example, policy.signals, str(number), name, table)
        length = min(map(len, signals.values()))
        found.append(({key: values[:length] for key, values in signals.items()}, example.step_s))
    return sorted(found, key=lambda one: len(next(iter(one[0].values()))))


def changes(values: Array) -> list[int]:
    return [int(at) + 1 for at in np.flatnonzero(np.diff(values))]


def other(values: Array) -> Array:
    """Return what a signal does not show."""
    return 1.0 - values if set(values) <= {0.0, 1.0} else values + 1.0


def changing_at(values: Array, at: int) -> Array:
    """Return a signal with its change nearest to `at` moved there; one that never changes begins as something else."""
    places, all_ = changes(values), np.arange(len(values))
    if not places:
        return np.where(all_ < at, other(values), values)
    shift = at - min(places, key=lambda place: abs(place - at))
    return values[np.clip(all_ - shift, 0, len(values) - 1)]


def discrete(policy: Policy) -> list[str]:
    """Return the signals of a formula that are no measurements."""
    table = signal_table(policy.file)
    return sorted(key for key in signals_of(policy.formula) if table[key].kind != "real")


def pairs(policy: Policy, name: str) -> Iterator[tuple[Signals, float, str, str]]:
    """Yield one flight for each two signals of a policy, such that the first changes in it if it does in any."""
    seen, names = set[tuple[str, str]](), discrete(policy)
    for wanted in (True, False):
        for signals, step_s in flights(policy, name):
            for first, second in permutations(names, 2):
                if (first, second) not in seen and bool(changes(signals[first])) == wanted:
                    seen |= {(first, second), (second, first)}
                    yield signals, step_s, first, second


def cases(policy: Policy, name: str) -> Iterator[Case]:
    """Yield signals at moments, the sample of each, the time of a sample, and what was done in words."""
    signals, step_s = flights(policy, name)[0]
    samples = len(next(iter(signals.values())))
    for key, apart in product(discrete(policy)[:PAIRS_MAX], (1, 2)):
        shown, at = signals[key].copy(), [*changes(signals[key]), samples // 2][0]
        shown[at : at + apart] = other(shown[at - 1 : at])
        yield {**signals, key: shown}, [*range(samples)], step_s, f"{key} for {apart} samples"
    for signals, step_s, first, second in islice(pairs(policy, name), PAIRS_MAX if samples <= SAMPLES_MAX else 1):
        samples = len(signals[first])
        at = [*changes(signals[first]), samples // 2][0]
        begun = {**signals, first: changing_at(signals[first], at)}
        for apart in (-2, -1, 0, 1, 2):
            place = min(max(1, at + apart), samples - 1)
            moved = {**begun, second: changing_at(signals[second], place)}
            yield moved, [*range(samples)], step_s, f"{second} {apart} after {first}"
        together = {**begun, second: changing_at(signals[second], at)}
        row = sorted([*range(samples), at])
        for early, late in ((first, second), (second, first)):
            held = {key: values[row] for key, values in together.items()}
            held[late][at] = together[late][at - 1]  # the first of the two moments of this sample
            yield held, row, step_s, f"{early} before {late} in one instant"


def compared() -> list[str]:
    """Return the policies that name a signal that is no measurement."""
    return [name for name in policy_names() if discrete(load_policy(name))]


THIRDS = [pytest.param(name, marks=pytest.mark.live if place % 3 else ()) for place, name in enumerate(compared())]


@pytest.mark.parametrize("name", THIRDS)
def test_events_apart_are_judged_as_the_page_on_time_says(name: str) -> None:
    policy = load_policy(name)
    by_definition = None
    for signals, row, step_s, words in cases(policy, name):
        evaluator = Evaluator(signals, step_s, np.asarray(row))
        by_definition = Definition(signals, step_s, row, by_definition)
        (body,) = policy.formula.args
        same = np.isclose(evaluator.trace(body), by_definition.values(body), rtol=1e-9, atol=1e-6, equal_nan=True)
        assert same.all(), f"{words}: moments {np.flatnonzero(~same)}"
        found = find(evaluator, policy.formula)
        assert found is not None, words
        if not abs(found.robustness) < 1e-6:  # sums in another order may differ in the last digits
            assert (not found.robustness < 0.0) == by_definition.holds(policy.formula), words


def test_the_policies_left_out_are_those_without_events() -> None:
    for name in set(policy_names()) - set(compared()):
        assert not {part.op for part in parts(load_policy(name).formula)} & {"rise", "fall", "latch"}, name
