"""What no message may hold is refused when it is decoded, with the path of the fault."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from msgspec import inspect

from saflite.campaign.engine.worker_registry import WORKERS_MAX
from saflite.console.run_data.known import Known
from saflite.console.run_data.provenance import Provenance
from saflite.console.view.dashboard.app import Order
from saflite.contract import topics, wire
from saflite.contract.blobs import BlobGet
from saflite.contract.bounds import TEXT_CHARS_MAX, told
from saflite.contract.control import Control, Status
from saflite.contract.errors import Refused
from saflite.contract.flight import Trace
from saflite.contract.join import Join
from saflite.contract.modules import Outside
from saflite.contract.score import Score, Usage
from saflite.contract.test_case import Stimulus
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import Ask, Heartbeat, Report
from saflite.runtime.client import FarmInfo
from saflite.runtime.webhook import Cursor

ID = "0123456789abcdef"
SCORE = {"test_case": ID, "value": 1.0, "model": "m", "scored_by": "m"}
BEAT = {"worker": "w", "stage": "fly"}


def _flown(**said: Any) -> dict[str, Any]:
    flight = {"test_case": ID, "flight_index": 0, "ending": "completed", **said}
    return {"worker": "w", "lease_id": "l", "epoch": 1, "result": {"type": "flown", "flight": flight}}


@pytest.mark.parametrize(
    ("kind", "fields", "path"),
    [
        (Control, {"verb": "events", "number": 2**63}, "$.number"),
        (Control, {"verb": "budget", "number": -1}, "$.number"),
        (Control, {"verb": "scorer", "text": "x" * (TEXT_CHARS_MAX + 1)}, "$.text"),
        (Join, {"protocol": 2, "cores": -1}, "$.cores"),
        (Join, {"protocol": 2, "labels": {str(place): "" for place in range(65)}}, "$.labels"),
        (Ask, {**BEAT, "wait_s": float("nan")}, "$.wait_s"),
        (Ask, {**BEAT, "leases_max": 2**63}, "$.leases_max"),
        (Heartbeat, {**BEAT, "busy_s": float("nan")}, "$.busy_s"),
        (Heartbeat, {**BEAT, "done": 2**64 - 1}, "$.done"),
        (Score, {**SCORE, "value": float("inf")}, "$.value"),
        (Score, {**SCORE, "value": float("nan")}, "$.value"),
        (Usage, {"tokens_in": 2**63}, "$.tokens_in"),
        (Judgement, {"test_case": ID, "flight_index": 2**63, "verdicts": []}, "$.flight_index"),
        (Verdict, {"policy": "p", "outcome": "violated", "robustness": float("-inf")}, "$.robustness"),
        (Verdict, {"policy": "p", "outcome": "vacuous", "nearness": 1.5}, "$.nearness"),
        (BlobGet, {"digest": 4 * ID, "offset": 2**63}, "$.offset"),
        (Report, _flown(simulated_s=float("nan")), "$.result.flight.simulated_s"),
        (Report, _flown(trace={"digest": 4 * ID, "size_bytes": 2**63}), "$.result.flight.trace.size_bytes"),
    ],
)
def test_a_field_out_of_bounds_is_refused_by_name(kind: type[Any], fields: dict[str, Any], path: str) -> None:
    with pytest.raises(Refused, match=path.replace("$", r"\$")):
        wire.decode(msgspec.msgpack.encode(fields), kind)


@pytest.mark.parametrize("opening", [b"\x91", b"\x81\xa1a"])
def test_deep_nesting_is_refused(opening: bytes) -> None:
    for depth in (100, 10_000, 1_000_000):
        with pytest.raises(Refused):
            wire.decode(opening * depth + b"\xc0", Control)
        with pytest.raises(Refused):  # an unknown field is skipped, but not without end
            wire.decode(b"\x82\xa4verb\xa6status\xa1x" + opening * depth, Control)


def test_words_of_others_are_made_fit_for_a_message() -> None:
    assert told("\ud800 and so on") == "? and so on"
    assert len(told("x" * (TEXT_CHARS_MAX + 1))) == TEXT_CHARS_MAX
    assert told("schön") == "schön"


def test_no_field_of_any_message_is_without_bounds() -> None:
    rows = [kind for row in topics.TOPICS for kind in (row.message, row.answer)]
    kinds: set[type[msgspec.Struct]] = {kind for kind in rows if kind is not None}
    types: tuple[type[msgspec.Struct], ...] = (*kinds, Trace)
    found = sorted({f"{place}" for kind in types for place in _unbounded(inspect.type_info(kind), kind.__name__)})
    assert not [place for place in found if not place.endswith(MAY_BE_ANY)], found


@pytest.mark.parametrize("kind", [Known, FarmInfo, Provenance, Order, Outside, Cursor])
def test_no_field_of_a_file_or_order_is_without_bounds(kind: type[msgspec.Struct]) -> None:
    """What is read from files that others may have made (a corpus, a run folder) and from a page; it becomes paths."""
    assert not [place for place in _unbounded(inspect.type_info(kind), kind.__name__) if not place.endswith(MAY_BE_ANY)]


MAY_BE_ANY = (
    "changed{}: float",  # a sample of a signal, which may be no number
    "signals{}: bytes",  # bounded by what a trace may unpack to
    "events[]: bytes",  # bounded by the message
)


def _unbounded(info: Any, path: str) -> Iterator[str]:
    """Yield the places below a type where a number, a text or a collection has no bound."""
    match info:
        case inspect.StructType():
            for field in info.fields:
                yield from _unbounded(field.type, f"{info.cls.__name__}.{field.encode_name}")
        case inspect.UnionType():
            for one in info.types:
                yield from _unbounded(one, path)
        case inspect.IntType() | inspect.FloatType():
            if info.ge is None or info.le is None:
                yield f"{path}: {type(info).__name__.removesuffix('Type').lower()}"
        case inspect.StrType():
            if info.max_length is None and info.pattern is None:
                yield f"{path}: str"
        case inspect.BytesType():
            if info.max_length is None:
                yield f"{path}: bytes"
        case inspect.VarTupleType() | inspect.ListType():
            if info.max_length is None:
                yield f"{path}: items"
            yield from _unbounded(info.item_type, f"{path}[]")
        case inspect.TupleType():
            for one in info.item_types:
                yield from _unbounded(one, f"{path}[]")
        case inspect.DictType():
            if info.max_length is None:
                yield f"{path}: entries"
            yield from _unbounded(info.key_type, f"{path}{{key}}")
            yield from _unbounded(info.value_type, f"{path}{{}}")


def test_what_cannot_be_sent_is_refused_before_it_is() -> None:
    for name in ("\ud800", "x" * 70_000):
        with pytest.raises(Refused, match="Stimulus"):
            wire.checked(Stimulus(at_s=0.0, kind="command", name=name), Stimulus)
    stimulus = Stimulus(at_s=0.0, kind="command", name="x")
    assert wire.checked(stimulus, Stimulus) == stimulus


def test_what_all_workers_say_of_their_time_fits_into_a_status() -> None:
    """It is summed there over all lives of all workers; each of two said the most there is, and nobody got a status."""
    assert _most(Heartbeat, "processor_s") * WORKERS_MAX * 1e6 < _most(Status, "processor_s")


def _most(kind: type, name: str) -> float:
    found = inspect.type_info(kind)
    assert isinstance(found, inspect.StructType)
    number = next(field.type for field in found.fields if field.name == name)
    assert isinstance(number, inspect.FloatType)
    assert number.le is not None
    return number.le
