"""Traces come back from their packed form bit by bit, whatever numbers are in them."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.bounds import ITEMS_MAX, TEXT_CHARS_MAX
from saflite.contract.errors import Refused
from saflite.contract.flight import (
    SAID_CHARS_MAX,
    SAMPLES_MAX,
    Delivered,
    Flight,
    FlightRecord,
    Trace,
    TraceMessage,
    matches_digest,
    pack_trace,
    readable,
    trace_digest,
    unpack_trace,
)
from saflite.contract.rng import derive
from saflite.contract.wire import decode, encode


def traces() -> list[Trace]:
    bits = derive(1, "bits").integers(0, 2**32, 999, dtype=np.uint32)  # NaN of any payload, denormals, both zeros
    smooth = (50.0 + np.sin(np.arange(999) / 30)).astype("<f4")
    edges = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-45, -3.4e38], dtype="<f4")
    return [
        Trace(step_s=0.05, signals={"x_m": bits.astype("<u4").tobytes(), "y_m": smooth.tobytes()}),
        Trace(step_s=0.05, signals={"x_m": edges.tobytes()}),
        Trace(step_s=0.05, signals={"x_m": b""}),
        Trace(step_s=0.05, signals={}),
    ]


@pytest.mark.parametrize("trace", traces())
def test_a_packed_trace_comes_back_bit_by_bit(trace: Trace) -> None:
    packed, told = pack_trace(trace), trace_digest(trace)
    assert unpack_trace(packed, told) == trace
    assert matches_digest(packed, told)
    assert not matches_digest(packed, told[::-1])
    assert not matches_digest(packed[:-1], told)


def test_what_moves_smoothly_takes_less_than_two_thirds() -> None:
    smooth = (50.0 + np.sin(np.arange(9999) / 30)).astype("<f4").tobytes()
    assert len(pack_trace(Trace(step_s=0.05, signals={"x_m": smooth}))) < len(smooth) * 2 / 3


def test_half_a_sample_is_refused_when_it_is_read() -> None:
    with pytest.raises(Refused, match="four bytes"):
        unpack_trace(pack_trace(Trace(step_s=0.05, signals={"x_m": b"12345"})))


def test_more_samples_than_are_judged_are_refused_before_they_are_unfolded() -> None:
    """A few packed KiB held 16 million samples, by which the policies that ship take more than 6 GB."""
    most = Trace(step_s=0.001, signals={"x_m": bytes(4 * SAMPLES_MAX)})
    assert unpack_trace(pack_trace(most)).samples == SAMPLES_MAX
    for signals in ({"x_m": bytes(4 * SAMPLES_MAX + 4)}, {"x_m": b"", "y_m": bytes(16 * SAMPLES_MAX - 4096)}):
        packed = pack_trace(Trace(step_s=0.001, signals=signals))
        assert len(packed) < 80_000
        with pytest.raises(Refused, match=f"at most {SAMPLES_MAX} samples"):
            unpack_trace(packed)


@pytest.mark.parametrize("text", ["x" * (TEXT_CHARS_MAX + 1), "half \ud800", "short"])
def test_what_an_autopilot_said_never_makes_a_flight_unreadable(text: str) -> None:
    """A vehicle that talked too long before it died was judged by nobody: its flight could not be read."""
    said = (*[TraceMessage(at_s=0.0, text=text)] * (ITEMS_MAX + 1), TraceMessage(at_s=1.0, text="PANIC"))
    trace = Trace(step_s=0.1, signals={"x_m": bytes(8)}, messages=said)
    record = readable(FlightRecord("autopilot_died", trace, text, (Delivered(index=0, at_s=0.0, message=text),)))
    assert record.trace is not None
    back = unpack_trace(pack_trace(record.trace), trace_digest(record.trace))
    assert len(back.messages) == (ITEMS_MAX if len(text) < 100 else SAID_CHARS_MAX // TEXT_CHARS_MAX + 1)
    assert back.messages[-1].text == "PANIC"
    flight = Flight(
        test_case="0" * 16, flight_index=0, ending=record.ending, message=record.message, delivered=record.delivered
    )
    assert decode(encode(flight), Flight) == flight
