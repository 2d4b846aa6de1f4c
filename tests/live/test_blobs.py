"""Blobs over real Zenoh: a trace larger than a message, while the books go on answering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from saflite.bus.private_socket import PrivateSocket
from saflite.bus.zenoh import open_client, open_router
from saflite.contract.flight import Flight, Trace, pack_trace, trace_digest, unpack_trace
from saflite.contract.rng import derive
from saflite.contract.wire import MESSAGE_BYTES_MAX
from saflite.contract.work import FlyResult, Report
from saflite.evidence.folder import BlobFolder
from saflite.runtime.blob_client import BusBlobs, WorkerBlobs
from saflite.runtime.clock import WallClock
from saflite.runtime.evidence import EvidenceService

pytestmark = pytest.mark.live


def test_a_trace_larger_than_a_message_gets_to_the_books_and_to_another_worker(tmp_path: Path) -> None:
    socket, store = PrivateSocket(), BlobFolder(tmp_path / "run")
    router = open_router("books", socket.endpoint)
    evidence = EvidenceService(router, "c", store)
    buses = [open_client(name, socket.endpoint) for name in ("fly-1", "judge-1")]
    flyer, judge = (WorkerBlobs(BusBlobs(bus, "c", bus.name, WallClock()), bus.name, None, ()) for bus in buses)
    rng = derive(1, "noise")
    noise = {f"s{number}": rng.random(2**20, dtype=np.float32).tobytes() for number in range(10)}
    trace = Trace(step_s=0.01, signals=noise)
    ref = flyer.put(pack_trace(trace))
    assert ref.size_bytes > MESSAGE_BYTES_MAX
    flight = Flight(test_case="x", flight_index=1, ending="completed", trace_digest=trace_digest(trace), trace=ref)
    report = Report(worker="fly-1", lease_id="x", epoch=1, result=FlyResult(flight=flight))
    told: list[str | None] = []
    evidence.inspect(report, told.append)
    evidence.answered(report)
    assert unpack_trace(judge.get(ref), flight.trace_digest).signals == noise
    evidence.close()
    assert told == [""]
    assert not list((tmp_path / "run" / "blobs" / "incoming" / "fly-1").iterdir()), "what was taken is gone"
    for bus in (*buses, router):
        bus.close()
    socket.close()
