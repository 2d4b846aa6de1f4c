"""The moments at which a flight is judged: its samples, and what held between stimuli of one instant.

A sample at time t shows what held just before the stimuli of t were given; what they did first shows at the next one.
Where several are given at once, the trace holds only what was left in the end, so `Flight.delivered` tells what each of
them changed: after each comes a moment of its own, later than the sample before it, earlier than the one after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Delivered, Trace
from saflite.oracle import windows
from saflite.oracle.windows import Array

Rows = NDArray[np.intp]


class Moments(NamedTuple):
    """When a flight is judged. All arrays have the shape (moments,).

    `row` is the latest sample at or before each moment, `time_s` its time; `changes` are places in these arrays and the
    signals that a stimulus changed there.
    """

    row: Rows
    time_s: Array
    changes: tuple[tuple[int, Mapping[str, float]], ...] = ()

    def held(self, name: str, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return a signal of shape (samples,) at every moment: a change holds until the next sample."""
        if not self.changes:
            return values
        found = values[self.row]
        for place, changed in self.changes:
            if name in changed:
                found[place : np.searchsorted(self.row, self.row[place], side="right")] = changed[name]
        return found


def samples_of(trace: Trace) -> Moments:
    """Return the samples alone."""
    row = np.arange(trace.samples, dtype=np.intp)
    return Moments(row, row * np.float64(trace.step_s))


def moments_of(trace: Trace, delivered: Sequence[Delivered] | None) -> Moments:
    """Return the samples and a moment after each stimulus that changed a signal at once, but for the last sample's."""
    samples = samples_of(trace)
    told = [one for one in delivered or () if one.changed.keys() & trace.signals.keys()]
    after = [int(np.searchsorted(samples.time_s, one.at_s + 1e-9, side="right")) - 1 for one in told]
    kept = sorted(
        ((row, one) for row, one in zip(after, told, strict=True) if 0 <= row < trace.samples - 1),
        key=lambda pair: pair[0],
    )
    if not kept:
        return samples
    before = np.array([row + 1 for row, _ in kept])  # inserted before the next sample, in the order given
    return Moments(
        np.insert(samples.row, before, [row for row, _ in kept]),
        np.insert(samples.time_s, before, [one.at_s for _, one in kept]),
        tuple((row + 1 + number, one.changed) for number, (row, one) in enumerate(kept)),
    )


class Uneven:
    """Extremes over windows of time where some samples have further moments after them; see `windows`.

    A window from and to counts of samples holds the moments of those samples; one that begins now begins at the very
    moment.
    """

    def __init__(self, row: Rows) -> None:
        self._forward, self._backward = _Ahead(row), _Ahead((row[-1] - row)[::-1] if len(row) else row)

    def least_ahead(self, values: Array, low: int, high: int | None) -> Array:
        """Return at each moment the least over the window ahead, shape (moments,); infinity where it is empty."""
        return self._forward.least(values, low, high)

    def greatest_ahead(self, values: Array, low: int, high: int | None) -> Array:
        """Return at each moment the greatest over the window ahead."""
        return -self.least_ahead(-values, low, high)

    def least_behind(self, values: Array, low: int, high: int | None) -> Array:
        """Return at each moment the least over the window behind."""
        return self._backward.least(values[::-1], low, high)[::-1]

    def greatest_behind(self, values: Array, low: int, high: int | None) -> Array:
        """Return at each moment the greatest over the window behind."""
        return -self.least_behind(-values, low, high)

    def until(self, left: Array, right: Array, low: int, high: int | None) -> Array:
        """Return the robustness of `left until[low:high] right` at each moment."""
        if not low and high is None:  # neither depends on when a moment was
            return windows.until(left, right, 0, None)
        return self._forward.until(left, right, low, high)

    def since(self, left: Array, right: Array, low: int, high: int | None) -> Array:
        """Return the robustness of `left since[low:high] right` at each moment."""
        if not low and high is None:
            return windows.since(left, right, 0, None)
        return self._backward.until(left[::-1], right[::-1], low, high)[::-1]


class _Ahead:
    """What lies ahead of each moment; `row` holds the sample of each, ascends, and leaves no sample out."""

    def __init__(self, row: Rows) -> None:
        self._row = row
        self._begins = np.searchsorted(row, np.arange(int(row[-1]) + 1 if len(row) else 0))
        self._has_next = np.flatnonzero(row[:-1] == row[1:])[::-1]  # moments with another of their sample, last first

    def least(self, values: Array, low: int, high: int | None) -> Array:
        """Return the least of each moment's window: of whole samples, and of what is left of its own."""
        if not len(values):
            return values
        rest = values.copy()
        for place in self._has_next:
            rest[place] = np.minimum(values[place], rest[place + 1])
        if low == high == 0:
            return rest
        of_samples = rest[self._begins]
        ahead = windows.least_ahead(of_samples, max(low, 1), high)[self._row]
        return ahead if low else np.minimum(rest, ahead)

    def until(self, left: Array, right: Array, low: int, high: int | None) -> Array:
        """Return the robustness of `left until[low:high] right`; as `windows.until`, for windows of any widths."""
        first, last = self._window(low, high)
        found = np.full(len(left), -np.inf)
        places = np.flatnonzero(first <= last)
        if not len(places):
            return found
        begins, widths = first[places], last[places] - first[places] + 1
        kept = _Least(left, max(int(widths.max()), int((begins - places).max())))
        found[places] = _reached(kept, right, begins, widths)
        late = begins > places
        found[places[late]] = np.minimum(kept.between(places[late], begins[late]), found[places[late]])
        return found

    def _window(self, low: int, high: int | None) -> tuple[Rows, Rows]:
        """First and last place of each moment's window; the last before the first where it is empty."""
        first = np.searchsorted(self._row, self._row + low) if low else np.arange(len(self._row))
        ends = len(self._row) if high is None else np.searchsorted(self._row, self._row + high, side="right")
        return first, np.broadcast_to(ends - 1, first.shape)


class _Least:
    """The least of any stretch of samples no longer than `longest`: of 1, 2, 4, ... samples from each on."""

    def __init__(self, values: Array, longest: int) -> None:
        self._from = [values]
        have = 1
        while have * 2 <= longest:
            before = self._from[-1]
            self._from.append(np.concatenate([np.minimum(before[:-have], before[have:]), before[-have:]]))
            have *= 2

    def of(self, power: int) -> Array:
        """Return the least of each sample and those after it, 2 to the power of `power` in all (or up to the end)."""
        return self._from[power]

    def between(self, begins: Rows, ends: Rows) -> Array:
        """Return the least from `begins` up to before `ends`, which come later; shape of either."""
        found, powers = np.empty(len(begins)), _power(ends - begins)
        for power in np.unique(powers):
            at, least = powers == power, self._from[power]
            found[at] = np.minimum(least[begins[at]], least[ends[at] - (1 << power)])
        return found


def _reached(kept: _Least, right: Array, begins: Rows, widths: Rows) -> Array:
    """Return what `windows._until_within` does for a window of its own width from each of `begins` on."""
    found, powers, reached = np.empty(len(begins)), _power(widths), right.copy()
    for power in range(int(powers.max()) + 1):
        have = 1 << power
        at = powers == power
        begin, rest = begins[at], widths[at] - have
        value, longer = reached[begin], rest > 0
        begin, then = begin[longer], begin[longer] + rest[longer]
        value[longer] = np.maximum(value[longer], np.minimum(kept.between(begin, then), reached[then]))
        found[at] = value
        if power < powers.max():
            there = len(right) - have
            through = kept.of(power)[:there]
            reached[:there] = np.maximum(reached[:there], np.minimum(through, reached[have:]))
    return found


def _power(counts: Rows) -> Rows:
    """Return the greatest power of two that is no more than each count, as its exponent."""
    return np.asarray(np.frexp(counts)[1] - 1, dtype=np.intp)
