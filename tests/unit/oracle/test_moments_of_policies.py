"""Every policy is judged alike where an input of no effect adds a moment 0, 1 or 2 samples from an event.

For flights of the reference `tests/replay/test_edges.py` has inputs that meet; the policies here may be any, those for
Betaflight and PX4 among them. Their own examples are the flights.
"""

from __future__ import annotations

import numpy as np
import pytest

from saflite.oracle.examples import completed, example_signals
from saflite.oracle.finding import find
from saflite.oracle.policy import load_policy, policy_names, signal_table
from saflite.oracle.stl import Evaluator


@pytest.mark.parametrize("apart", [-2, -1, 0, 1, 2])
@pytest.mark.parametrize("name", policy_names())
def test_a_moment_at_which_nothing_changes_changes_no_verdict(name: str, apart: int) -> None:
    policy = load_policy(name)
    table = signal_table(policy.file)
    for number in range(1, len(policy.file.examples) + 1):
        example = completed(policy.file.examples, number, name)
        signals = example_signals(example, policy.signals, str(number), name, table)
        length = min(len(values) for values in signals.values())
        steps = [np.diff(values[:length]) != 0 for key, values in signals.items() if table[key].kind != "real"]
        events = np.flatnonzero(np.any(steps, axis=0)) + 1 if steps else np.zeros(0, dtype=np.intp)
        row = np.sort(np.concatenate([np.arange(length), np.clip(events + apart, 0, length - 1)]))
        plain = find(Evaluator(signals, example.step_s), policy.formula)
        met = find(
            Evaluator({key: values[row] for key, values in signals.items()}, example.step_s, row), policy.formula
        )
        assert plain is not None
        assert met is not None
        assert (met.robustness >= 0.0) == (plain.robustness >= 0.0) == example.holds, f"example {number}: {example.why}"
