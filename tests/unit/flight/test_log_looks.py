"""What is made of a log takes time with its length alone: nothing of it is looked through again for each event."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from saflite.contract.rng import derive
from saflite.flight.logs import ulog_failures
from saflite.flight.logs.flight_log import stands_by_height
from saflite.flight.logs.resample import Columns

Array = NDArray[Any]
MANY = 1000


class Looked(np.ndarray[Any, Any]):
    """An array that counts how many of its values are worked on."""

    looks = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **words: Any) -> Any:
        plain = [np.asarray(one) if isinstance(one, Looked) else one for one in inputs]
        Looked.looks += max(map(np.size, plain))
        out = {"out": tuple(map(np.asarray, words.pop("out")))} if "out" in words else {}
        made = getattr(ufunc, method)(*plain, **words, **out)
        return made.view(Looked) if isinstance(made, np.ndarray) else made


class LookedColumns(Columns):
    def get(self, name: str) -> tuple[Array, Array] | None:
        found = super().get(name)
        return None if found is None else (found[0].view(Looked), found[1].view(Looked))


def looks_of(act: Callable[[], Any]) -> tuple[Any, int]:
    before = Looked.looks
    return act(), Looked.looks - before


def test_heights_that_leap_time_and_again_are_followed_in_one_look() -> None:
    """10 MB of a height that leaps at every sample took ten minutes."""
    at_s = 0.1 * np.arange(2 * MANY)
    heights_m = derive(1, "leaps").uniform(-30.0, 30.0, len(at_s))
    columns = Columns()
    columns.add("altitude_m", at_s, heights_m)
    columns.height_leaps = [(at_s[row], at_s[row + 1]) for row in range(5, len(at_s) - 1) if row % 3]
    times = np.arange(-1.0, at_s[-1] + 1.0, 0.05)
    leapt_m, looks = looks_of(lambda: columns._leapt(times.view(Looked)))
    expected_m = np.zeros(len(times))
    for from_s, to_s in columns.height_leaps:
        up_m = np.diff(np.interp([from_s, to_s], at_s, heights_m))[0]
        expected_m += up_m * np.clip((times - from_s) / (to_s - from_s), 0.0, 1.0)
    assert np.asarray(leapt_m) == pytest.approx(expected_m, abs=1e-6)
    assert looks < 10 * len(times)


def test_two_heights_at_one_time_leap_by_what_lies_between_them() -> None:
    columns = Columns()
    columns.add("altitude_m", [0.0, 1.0, 1.0, 2.0], [0.0, 0.0, 9.0, 9.0])
    columns.height_leaps = [(1.0, 1.0)]
    assert np.isfinite(columns._leapt(np.array([0.0, 1.0, 2.0]))).all()


def test_where_it_leaves_the_ground_is_looked_for_between_two_armings_alone() -> None:
    columns = LookedColumns()
    columns.add("altitude_m", np.arange(4.0 * MANY), np.tile([0.0, 0.5, 3.0, 4.0], MANY))
    armed = [(4.0 * number, 1.0) for number in range(MANY)]
    stood, looks = looks_of(lambda: stands_by_height(columns, armed))
    assert stood == [(0.0, 1.0), *((4.0 * number + 2.0, 0.0) for number in range(MANY))]
    assert looks < 10 * 4 * MANY


def test_since_when_it_lies_is_told_of_many_hits_in_one_look() -> None:
    at_s = np.arange(4.0 * MANY)
    armed, lost = (np.tile(flags, MANY) for flags in ([True, True, True, False], [True, True, False, False]))
    hits_s = at_s[1::4] + 0.5
    lies, looks = looks_of(lambda: ulog_failures._since_a_hit(at_s.view(Looked), lost, armed, hits_s.view(Looked)))
    assert np.asarray(lies).tolist() == [False, False, True, False] * MANY
    assert looks < 50 * len(at_s)
