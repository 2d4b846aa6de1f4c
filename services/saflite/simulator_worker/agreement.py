"""Does a target do what it says of itself? What `describe()` says against what its flights left behind."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import get_args

from saflite.contract.flight import SAMPLES_MAX, Delivered, DeliveryAnswer, Ending, FlightRecord, Trace
from saflite.contract.names import NAME_EXPECTED, is_name
from saflite.contract.signals import SIGNALS
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import TestCase

ENDINGS: frozenset[str] = frozenset(get_args(Ending))
ANSWERS: frozenset[str] = frozenset(get_args(DeliveryAnswer))
NEED_A_TRACE: frozenset[Ending] = frozenset({"completed", "crashed", "timed_out"})
EARLY_S = 1e-6
SHOWN = 5


def own_contradictions(info: TargetInfo) -> Iterator[str]:
    """Yield where a description contradicts itself."""
    if not is_name(info.name):
        yield f"describe() names the target {info.name[:80]!r}: expected {NAME_EXPECTED}"
    nameless = [name for name in info.signals if name not in SIGNALS and name not in info.own_signals]
    if nameless:
        yield f"describe() names {_few(nameless)}, neither a common signal nor one of own_signals"
    unwritten = [name for name in info.own_signals if name not in info.signals]
    if unwritten:
        yield f"describe() has own_signals {_few(unwritten)}, not among signals"
    if not info.signals:
        yield "describe() names no signal"
    if not info.build and not info.missing:
        yield "describe() gives no build"
    if not info.missions and not info.start_states:
        yield "describe() gives neither missions nor a start state: there is no flight to begin"
    for one in info.inputs:
        if one.low is not None and one.high is not None and one.low > one.high:
            yield f"input {one.name}: its range goes from {one.low:g} down to {one.high:g}"
        elif one.default is not None and not _within(one, one.default):
            yield f"input {one.name}: its default {one.default:g} is not in its range"
    names = [(one.kind, one.name) for one in info.inputs]
    for kind, name in sorted({pair for pair in names if names.count(pair) > 1}):
        yield f"input {kind} {name} is described more than once"


def _within(one: InputInfo, value: float) -> bool:
    return not (one.low is not None and value < one.low) and not (one.high is not None and value > one.high)


def session_lacks(session: object) -> Iterator[str]:
    """Yield what a session does not have that every session has."""
    for name in ("fly", "close"):
        if not callable(getattr(session, name, None)):
            yield f"open() gave a {type(session).__name__} without {name}()"


def contradictions(info: TargetInfo, test_case: TestCase, record: object) -> Iterator[str]:
    """Yield where one flight contradicts the description of its target."""
    if not isinstance(record, FlightRecord):
        yield f"fly() returned a {type(record).__name__}, no FlightRecord"
        return
    if record.ending not in ENDINGS:
        yield f"ending {record.ending!r}, none of {', '.join(sorted(ENDINGS))}"
    said: object = record.message
    if not isinstance(said, str):
        yield f"message: expected a text, got {type(said).__name__}"
    if record.trace is not None:
        yield from _of_trace(info, record.trace)
    elif record.ending in NEED_A_TRACE:
        yield f"the flight ended as {record.ending} without a trace"
    yield from _of_delivered(test_case, record)
    names = [name for name, _ in record.artefacts]
    if len(set(names)) < len(names):
        yield f"two artefacts of one name among {_few(names)}"
    odd = [repr(name[:80]) for name in names if not is_name(name)]
    if odd:
        yield f"artefacts called {_few(odd)}: expected {NAME_EXPECTED}"


def _of_trace(info: TargetInfo, trace: Trace) -> Iterator[str]:
    missing = [name for name in info.signals if name not in trace.signals]
    if missing:
        yield f"the trace lacks {_few(missing)}, which describe() says every trace holds"
    unknown = [name for name in trace.signals if name not in info.signals]
    if unknown:
        yield f"the trace holds {_few(unknown)}, which describe() does not name"
    if not (math.isfinite(trace.step_s) and trace.step_s > 0.0):
        yield f"the trace has steps of {trace.step_s} s"
    if trace.samples > SAMPLES_MAX:
        yield f"the trace holds {trace.samples} samples, {SAMPLES_MAX} at most are judged"
    sizes = {name: len(data) / 4 for name, data in trace.signals.items()}
    other = [name for name, size in sizes.items() if size != trace.samples]
    if other:
        yield f"{_few(other)} not of {trace.samples} samples as the rest"


def _of_delivered(test_case: TestCase, record: FlightRecord) -> Iterator[str]:
    seen: set[int] = set()
    for given in record.delivered or ():
        if not 0 <= given.index < len(test_case.stimuli):
            yield f"delivered stimulus {given.index}, but the test case has {len(test_case.stimuli)}"
            continue
        if given.index in seen:
            yield f"stimulus {given.index} delivered twice"
        seen.add(given.index)
        if given.answer not in ANSWERS:
            yield f"stimulus {given.index}: answer {given.answer!r}, none of {', '.join(sorted(ANSWERS))}"
        if not given.at_s >= test_case.stimuli[given.index].at_s - EARLY_S:
            due_s = test_case.stimuli[given.index].at_s
            yield f"stimulus {given.index} delivered at {given.at_s:g} s, before it was due at {due_s:g} s"


def differences(first: FlightRecord, again: FlightRecord) -> Iterator[str]:
    """Yield where two flights of the same test case differ, bit by bit."""
    if first.ending != again.ending:
        yield f"ended as {first.ending}, then as {again.ending}"
    if first.delivered != again.delivered:
        yield "delivered differs"
    if first.trace is None or again.trace is None:
        if first.trace is not again.trace:
            yield "one of two flights has no trace"
        return
    one, two = first.trace, again.trace
    moved = [name for name in sorted(one.signals | two.signals) if one.signals.get(name) != two.signals.get(name)]
    if moved:
        yield f"{_few(moved)} not equal bit by bit"
    if one.messages != two.messages:
        yield "messages differ"
    if one.step_s != two.step_s:
        yield f"steps of {one.step_s:g} s, then of {two.step_s:g} s"


def beginning_differences(whole: FlightRecord, cut: FlightRecord, until_s: float) -> Iterator[str]:
    """Yield where a flight that ran out of time at `until_s` is not the beginning of the whole one, bit by bit."""
    if whole.trace is None or cut.trace is None:
        yield "one of two flights has no trace"
        return
    one, two = whole.trace, cut.trace
    late_s = two.duration_s - min(one.duration_s, until_s)
    if not abs(late_s) <= 2 * one.step_s:
        yield f"lasted {two.duration_s:g} s, expected {until_s:g}"
    size = 4 * min(one.samples, two.samples)
    moved = [name for name in sorted(one.signals | two.signals) if _head(one, name, size) != _head(two, name, size)]
    if moved:
        yield f"{_few(moved)} not equal bit by bit"
    certain_s = two.duration_s - two.step_s  # what is due in the last step may be the other flight's next one
    if _given(whole, certain_s) != _given(cut, certain_s):
        yield "delivered differs"


def _head(trace: Trace, name: str, size: int) -> bytes | None:
    data = trace.signals.get(name)
    return None if data is None else data[:size]


def _given(record: FlightRecord, until_s: float) -> list[Delivered]:
    return [one for one in record.delivered or () if one.at_s < until_s]


def _few(names: list[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{', '.join(names[:SHOWN])}{more}"
