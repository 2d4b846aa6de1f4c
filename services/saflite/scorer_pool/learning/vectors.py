"""What is worked out from a test case, kept by identity so that a history of thousands costs its numbers only once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import TestCase, identity
from saflite.scorer_pool.learning.features import FEATURES, features

KEPT_MAX = 20_000
T = TypeVar("T")


class Memo(Generic[T]):
    """A bounded store of what `make` gives for test cases. Safe to use from several threads."""

    def __init__(self, make: Callable[[Sequence[TestCase]], Iterable[T]]) -> None:
        self._make = make
        self._kept: OrderedDict[str, T] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, test_cases: Sequence[TestCase]) -> list[T]:
        """Return one item per test case, in order."""
        names = [identity(case) for case in test_cases]
        with self._lock:
            found = {name: self._kept[name] for name in names if name in self._kept}
        missing = {name: case for name, case in zip(names, test_cases, strict=True) if name not in found}
        made = dict(zip(missing, self._make(list(missing.values())), strict=True))
        with self._lock:
            self._kept.update(made)
            while len(self._kept) > KEPT_MAX:
                self._kept.popitem(last=False)
        found |= made
        return [found[name] for name in names]


class Vectors:
    """Feature vectors of test cases, each worked out once."""

    def __init__(self) -> None:
        self._memo: Memo[NDArray[np.float64]] = Memo(features)

    def of(self, test_cases: Sequence[TestCase]) -> NDArray[np.float64]:
        """Return the vectors of the test cases, shape (count, FEATURES)."""
        return np.stack(self._memo.of(test_cases)) if test_cases else np.zeros((0, FEATURES))
