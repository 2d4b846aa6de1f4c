"""Topics of a PX4 log by name, and what their fields say; one that a release does not have says nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saflite.flight.logs.resample import DURATION_MAX_S, check_no_other_flight, told_far_off

Topic = Mapping[str, Any]
Topics = Mapping[str, Topic]
Column = tuple[NDArray[np.float64], NDArray[np.float64]]

_RECEIVERS = ("sensor_gps", "vehicle_gps_position")
_FIX, _SATELLITES_MAX = ("fix_type", "satellites_used"), 256
_SILENT_US = 2_000_000
RECEIVERS_MAX = 10
"""Instances of a topic that PX4 can have (ORB_MULTI_MAX_INSTANCES). Each is looked at for every row of all."""


def chosen(datasets: Iterable[Any]) -> tuple[dict[str, Topic], tuple[str, ...]]:
    """Return a topic of each name, and in words what was left out.

    It is the lowest instance that has data, of batteries the first that is connected.
    Of several receivers each row is that of the one with the better position then, as PX4 chooses. Rows whose time is
    later than most of the log by more than a flight lasts are damage, and left out.

    Raises ValueError where they are another flight, or where there are more receivers than can be.
    """
    found: dict[str, list[Topic]] = {}
    dropped = 0
    told = [one for one in datasets if len(one.data["timestamp"]) > 0]
    middle_us = float(np.median(np.concatenate([one.data["timestamp"] for one in told]))) if told else 0.0
    for dataset in sorted(told, key=lambda one: (one.name, not _connected(one), one.multi_id)):
        good = dataset.data["timestamp"] <= middle_us + DURATION_MAX_S * 1e6
        check_no_other_flight(dataset.name, dataset.data["timestamp"] / 1e6, ~good)
        dropped += int(np.count_nonzero(~good))
        if good.any():
            found.setdefault(dataset.name, []).append({name: values[good] for name, values in dataset.data.items()})
    several = {name for name in _RECEIVERS if len(found.get(name, ())) > 1}
    for name in several:
        if len(found[name]) > RECEIVERS_MAX:
            raise ValueError(f"{len(found[name])} receivers of {name}, more than {RECEIVERS_MAX}")
    topics = {name: _better(told) if name in several else told[0] for name, told in found.items()}
    return topics, (told_far_off(dropped),) if dropped else ()


def _better(receivers: list[Topic]) -> Topic:
    """Return, from row to row of all, fix and satellites of the receiver with the better fix; a silent one has none."""
    stamps = np.unique(np.concatenate([one["timestamp"] for one in receivers]))
    told = []
    for one in receivers:
        place = np.searchsorted(one["timestamp"], stamps, side="right") - 1
        speaks = (place >= 0) & (stamps - one["timestamp"][np.maximum(place, 0)] <= _SILENT_US)
        rows = [np.where(speaks, one[name][place], 0) if name in one else np.zeros(len(stamps)) for name in _FIX]
        told.append(np.array(rows, dtype=np.float64))
    ranks = np.array([fix * _SATELLITES_MAX + satellites for fix, satellites in told])
    best = np.array(told)[ranks.argmax(axis=0), :, np.arange(len(stamps))]
    return {"timestamp": stamps, **dict(zip(_FIX, best.T, strict=True))}


def times(topic: Topic) -> NDArray[np.float64]:
    """Return when the rows of a topic were told, seconds since boot, shape (n,)."""
    return np.asarray(topic["timestamp"], dtype=np.float64) / 1e6


def field(topics: Topics, name: str, *names: str) -> Column | None:
    """Return times and values of the first of a topic's fields that it has, or None."""
    topic = topics.get(name, {})
    has = next((one for one in names if one in topic), None)
    return None if has is None else (times(topic), np.asarray(topic[has], dtype=np.float64))


def held(column: Column, at_s: Any) -> NDArray[np.float64]:
    """Return what a column that keeps each value until the next says at some times, shape of `at_s`."""
    told_s, values = column
    return values[np.maximum(np.searchsorted(told_s, np.asarray(at_s) + 1e-9, side="right") - 1, 0)]


def _connected(dataset: Any) -> bool:
    return dataset.name != "battery_status" or bool(np.any(dataset.data.get("connected", True)))
