"""The state of the books as bytes and back: a cache of the fold, so that a long journal need not be replayed whole.

What is kept is named by the annotations of the dataclasses, and for the other classes by `FIELDS`. Whatever has no
order of its own is sorted, whatever has one keeps it: equal journals give equal bytes, so that an audit can tell a
snapshot that does not come of its journal.
"""

from __future__ import annotations

import dataclasses
from collections import Counter, deque
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from saflite.campaign.engine.core import Core
from saflite.campaign.engine.outbox import Outbox
from saflite.campaign.engine.reducer import Reducer
from saflite.campaign.lifecycle.behaviours import Behaviour, Behaviours
from saflite.campaign.lifecycle.minimization import Attempt, Follower, Minimization, MinimizationCandidate
from saflite.campaign.lifecycle.minimizer import Evidence, Minimizer
from saflite.campaign.lifecycle.repeat_checks import RepeatChecks
from saflite.campaign.lifecycle.repeats import RepeatRule
from saflite.campaign.lifecycle.scorer_swap import Scorers
from saflite.campaign.scheduling.rounds import Round, Rounds
from saflite.campaign.scheduling.tasks import Task, TaskTable
from saflite.campaign.scheduling.work_keys import FlyKey, WarmKey, WorkKey
from saflite.contract import wire
from saflite.contract.flight import Flight
from saflite.contract.test_case import TestCase
from saflite.flight.novelty import Features

FIELDS: dict[type, dict[str, Any]] = {
    Outbox: {"seq": int, "line_count": int, "_unix_offset_s": float},
    Rounds: {
        "budget": int,
        "under_way": dict[int, Round],
        "recent": deque[Round],
        "planned": int,
        "closed_upto": int,
        "dry": int,
        "_known_cost": int,
        "_known_upto": int,
        "_costs": dict[int, tuple[int, int]],
    },
    TaskTable: {"_tasks": dict[WorkKey, Task]},
    Scorers: {
        "model": str,
        "shadow": tuple[str, ...],
        "pending": dict[WarmKey, tuple[bool, tuple[str, ...]]],
        "_count": int,
    },
    Behaviours: {"_expected": deque[str], "_undecided": list[str], "_known": dict[str, Behaviour]},
    RepeatChecks: {"_under_way": dict[FlyKey, tuple[TestCase, Flight]]},
    Minimization: {
        "_candidates": list[MinimizationCandidate],
        "_followers": list[Follower],
        "_enough": dict[str, frozenset[str]],
        "_under_way": dict[FlyKey, Attempt],
        "_shown": dict[FlyKey, frozenset[str]],
    },
    Minimizer: {
        "original": str,
        "rule": RepeatRule,
        "_forms": list[TestCase],
        "_left": int,
        "_ranges": dict[str, tuple[float, float]],
        "_decided": set[str],
        "_evidence": dict[str, Evidence],
        "_generation": dict[str, TestCase],
        "_width": int,
        "_wave": dict[tuple[str, int], bool | None],
        "_phase": int,
        "_helped": bool,
    },
}
"""What of the classes that are no dataclasses makes their state; `UNKEPT` is worked out again of what is kept."""

_ENCODER = msgspec.msgpack.Encoder(order="deterministic")
"""A peer may send the keys of a mapping in any order, the journal holds them sorted: a replay would differ in bytes."""

UNKEPT = {
    *("search", "confirm_flights", "selected_upto", "_queues", "_waiting", "_kinds", "_flown_on"),
    *("_core", "_by_words", "_told", "_placed"),
}

GIVEN = {"campaign", "template", "target", "confirm"}
"""What of the core comes of the campaign."""


def take(reducer: Reducer) -> bytes:
    """Return the state of the fold; nothing may wait in its outbox, which is not kept."""
    assert not reducer.core.out.waiting, "a snapshot between a change and its commit"
    core = {name: _pack(kind, getattr(reducer.core, name)) for name, kind in _core().items()}
    return _ENCODER.encode((core, [_pack(type(part), part) for part in _beside(reducer)]))


def put_back(reducer: Reducer, data: bytes) -> None:
    """Give fresh books the state of a snapshot.

    Raises:
        ValueError: it is none, or one of other books; the state is then undefined.
    """
    try:
        core, beside = wire.unpack(data, tuple[Any, Any])
        for name, kind in _core().items():
            _put(reducer.core, name, kind, core[name])
        for part, values in zip(_beside(reducer), beside, strict=True):
            _restore(part, values)
        reducer.core.tasks.enqueue_all()
        reducer.behaviours.index()
    except (msgspec.MsgspecError, ValueError, LookupError, TypeError, AttributeError) as fault:
        raise ValueError(f"not a snapshot of these books: {fault}") from fault


def _beside(reducer: Reducer) -> tuple[Minimization, RepeatChecks, Scorers, Behaviours]:
    return reducer.minimization, reducer.checks, reducer.scorers, reducer.behaviours


@cache
def _hints(kind: type) -> dict[str, Any]:
    return FIELDS.get(kind) or get_type_hints(kind)


def _core() -> dict[str, Any]:
    return {name: kind for name, kind in _hints(Core).items() if name not in GIVEN}


@cache
def _is_plain(kind: Any) -> bool:
    """Whether msgspec encodes such a value as it is, and in an order that is the same in every process."""
    if kind is Features or dataclasses.is_dataclass(kind) or kind in FIELDS:
        return False
    origin = get_origin(kind)
    return origin not in (dict, Counter, set, frozenset, deque) and all(_is_plain(part) for part in _parts(kind))


def _parts(kind: Any) -> tuple[Any, ...]:
    """Return the kinds a kind is made of; the words of a literal are none."""
    return tuple(part for part in get_args(kind) if part not in (Ellipsis, NoneType) and not isinstance(part, str))


def _pack(kind: Any, value: Any) -> Any:
    pack = _packer(kind)
    return value if pack is None or value is None else pack(value)


@cache
def _packer(kind: Any) -> Callable[[Any], Any] | None:
    """Return what makes plain values of those of a kind, none of them None; itself None if they are plain.

    Worked out once a kind: the books stand still while a snapshot is made, and there are many values.
    """
    if _is_plain(kind):
        return None
    if kind is Features:
        return lambda value: (value.points.tolist(), value.labels.tolist())
    if kind in FIELDS or dataclasses.is_dataclass(kind):
        return _whole_packer(_hints(kind))
    origin, parts = get_origin(kind), _parts(kind)
    if origin is dict:
        return _each_value(_packer(parts[1]))
    if origin is Counter:
        return lambda value: sorted(value.items())
    if origin in (set, frozenset):
        return sorted
    if origin in (Union, UnionType):
        return _packer(parts[0])
    return _each(_packer(parts[0]))


def _each(pack: Callable[[Any], Any] | None) -> Callable[[Any], list[Any]]:
    if pack is None:
        return list
    return lambda values: [None if one is None else pack(one) for one in values]


def _each_value(pack: Callable[[Any], Any] | None) -> Callable[[Any], list[Any]]:
    if pack is None:
        return lambda mapping: list(mapping.items())
    return lambda mapping: [(key, None if one is None else pack(one)) for key, one in mapping.items()]


def _whole_packer(fields: dict[str, Any]) -> Callable[[Any], list[Any]]:
    """Return what makes a list of the named parts of a value."""
    read = attrgetter(*fields) if len(fields) > 1 else None
    (name, *_) = fields
    packers = [(place, pack) for place, pack in enumerate(map(_packer, fields.values())) if pack is not None]

    def pack_whole(value: Any) -> list[Any]:
        values = [getattr(value, name)] if read is None else list(read(value))
        for place, pack in packers:
            if values[place] is not None:
                values[place] = pack(values[place])
        return values

    return pack_whole


def _unpack(kind: Any, value: Any) -> Any:
    if kind is Features:
        points, labels = value
        return Features(np.asarray(points, dtype=np.float64), np.asarray(labels, dtype=np.int64))
    if value is None or _is_plain(kind):
        return wire.convert(value, kind)
    if kind is Minimizer:
        return _restore(Minimizer.__new__(Minimizer), value)
    if dataclasses.is_dataclass(kind):
        fields = zip(_hints(kind).items(), value, strict=True)  # type: ignore[arg-type]
        return kind(**{name: _unpack(hint, one) for (name, hint), one in fields})  # type: ignore[operator]
    origin, parts = get_origin(kind), _parts(kind)
    if origin is dict:
        if all(map(_is_plain, parts)):
            return dict(wire.convert(value, list[tuple[parts[0], parts[1]]]))  # type: ignore[valid-type]
        return {wire.convert(key, parts[0]): _unpack(parts[1], one) for key, one in value}
    if origin is Counter:
        return Counter(dict(wire.convert(value, list[tuple[parts[0], int]])))  # type: ignore[valid-type]
    if origin in (set, frozenset):
        return origin(wire.convert(value, list[parts[0]]))  # type: ignore[valid-type]
    if origin in (Union, UnionType):
        return _unpack(parts[0], value)
    return [_unpack(parts[0], one) for one in value]


def _put(whole: Any, name: str, kind: Any, value: Any) -> None:
    """Set one attribute: parts that others hold a reference to are changed, not replaced."""
    if kind in FIELDS:
        _restore(getattr(whole, name), value)
    elif get_origin(kind) is deque:
        getattr(whole, name).extend(_unpack(list[_parts(kind)[0]], value))  # type: ignore[misc]
    else:
        setattr(whole, name, _unpack(kind, value))


def _restore(whole: Any, values: Any) -> Any:
    for (name, kind), value in zip(FIELDS[type(whole)].items(), values, strict=True):
        _put(whole, name, kind, value)
    return whole
