"""Feature vectors by identity, kept so that a history of thousands is turned into numbers only once."""

from __future__ import annotations

import threading
from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import TestCase, identity
from saflite.scorer_pool.learning.features import FEATURES, features

KEPT_MAX = 20_000


class Vectors:
    """A bounded store of feature vectors. Safe to use from several threads."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, NDArray[np.float64]] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, test_cases: list[TestCase]) -> NDArray[np.float64]:
        """Return the vectors of the test cases, shape (count, FEATURES)."""
        names = [identity(case) for case in test_cases]
        with self._lock:
            found = {name: self._kept[name] for name in names if name in self._kept}
        missing = {name: case for name, case in zip(names, test_cases, strict=True) if name not in found}
        made = dict(zip(missing, features(list(missing.values())), strict=True))
        with self._lock:
            self._kept.update(made)
            while len(self._kept) > KEPT_MAX:
                self._kept.popitem(last=False)
        found |= made
        return np.stack([found[name] for name in names]) if names else np.zeros((0, FEATURES))
