"""What results name is looked at before the books take them; who cannot see the folder gets there in chunks."""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest

from saflite.bus.base import Bus, Happening, Inbox, Reply
from saflite.bus.faulty import FaultyNetwork, Trouble
from saflite.bus.memory import MemoryNetwork
from saflite.contract.blobs import CHUNK_BYTES_MAX, BlobMissing, Blobs, ref_of
from saflite.contract.errors import Unavailable
from saflite.contract.flight import Artefact, Flight, Trace, pack_trace, trace_digest, unpack_trace
from saflite.contract.rng import derive
from saflite.contract.wire import MESSAGE_BYTES_MAX
from saflite.contract.work import Failure, FlyResult, Report
from saflite.evidence import quota
from saflite.evidence.folder import BlobFolder, WorkerFolder
from saflite.runtime.blob_client import BusBlobs, WorkerBlobs
from saflite.runtime.evidence import BlobRequests, EvidenceService, look

TRACE = Trace(step_s=0.1, signals={"x_m": derive(1, "x").random(50, dtype=np.float32).tobytes()})
MIB = 2**20


class SteppedBus:
    """A bus in memory whose questions are answered before `ask` returns; for code that waits."""

    def __init__(self, network: MemoryNetwork, name: str) -> None:
        self._network, self._bus = network, network.connect(name)
        self.name = name
        self.largest_bytes = self.questions = 0

    def ask(self, key: str, payload: bytes, tag: Hashable, inbox: Inbox, timeout_s: float) -> None:
        self.largest_bytes, self.questions = max(self.largest_bytes, len(payload)), self.questions + 1
        got: list[Happening] = []
        self._bus.ask(key, payload, tag, got.append, timeout_s)
        while not got:
            assert self._network.step(), "nothing is under way, and no answer came"
        inbox(got[0])

    def monotonic_s(self) -> float:
        return self._network.now_s

    def sleep_s(self, duration_s: float) -> None:
        self._network.run_until(self._network.now_s + duration_s)


def connected(network: MemoryNetwork, store: BlobFolder, worker: str = "fly-1") -> tuple[BusBlobs, SteppedBus]:
    """Serve a store and connect a worker to it."""
    network.connect("books").serve("saflite/2/c/blob/*", BlobRequests(store).answer)
    bus = SteppedBus(network, worker)
    face: Bus = bus  # type: ignore[assignment]
    return BusBlobs(face, "c", worker, bus), bus


def report(blobs: Blobs, flown: Trace = TRACE, **changed: object) -> Report:
    """A flight of `fly-1` that left its trace and a log."""
    flight = Flight(
        test_case="x",
        flight_index=1,
        ending="completed",
        trace_digest=trace_digest(flown),
        trace=blobs.put(pack_trace(flown)),
        artefacts=(Artefact(name="log", blob=blobs.put(b"log")),),
    )
    result = FlyResult(flight=msgspec.structs.replace(flight, **changed))
    return Report(worker="fly-1", lease_id="x", epoch=1, result=result)


@pytest.fixture
def store(tmp_path: Path) -> BlobFolder:
    return BlobFolder(tmp_path / "run")


@pytest.fixture
def left(tmp_path: Path) -> WorkerFolder:
    return WorkerFolder(tmp_path / "run", "fly-1")


def test_whole_blobs_are_in_the_store_once_looked_at(store: BlobFolder, left: WorkerFolder) -> None:
    told = report(left)
    assert look(store, told) == ""
    assert isinstance(told.result, FlyResult)
    assert all(store.get(blob) for blob in told.result.flight.blobs)
    assert look(store, told) == "", "a result sent again"


def test_what_is_wrong_is_said(store: BlobFolder, left: WorkerFolder) -> None:
    assert "is missing" in str(look(store, report(left, artefacts=(Artefact(name="log", blob=ref_of(b"never")),))))
    assert "not the one with the digest" in str(look(store, report(left, trace_digest="0" * 64)))
    assert "expected a digest" in str(
        look(store, report(left, trace=msgspec.structs.replace(ref_of(b""), digest="..")))
    )
    stranger = msgspec.structs.replace(report(left), worker="../fly-1")
    assert "worker name" in str(look(store, stranger))


@pytest.mark.parametrize(("size_bytes", "index", "on_the_spot"), [(9, 0, True), (2**17, 0, False), (9, 1, False)])
def test_only_a_first_flight_that_left_little_is_looked_at_on_the_spot(
    store: BlobFolder, left: WorkerFolder, size_bytes: int, index: int, on_the_spot: bool
) -> None:
    evidence = EvidenceService(MemoryNetwork().connect("books"), "c", store)
    said: list[tuple[str | None, int]] = []
    told = report(left, artefacts=(Artefact(name="log", blob=left.put(bytes(size_bytes))),), flight_index=index)
    evidence.inspect(told, lambda damage: said.append((damage, threading.get_ident())))
    evidence.close()
    assert [(damage, thread == threading.get_ident()) for damage, thread in said] == [("", on_the_spot)]


def test_what_a_worker_could_not_read_is_looked_for(store: BlobFolder) -> None:
    there, gone = store.put(b"there"), ref_of(b"gone")
    told = Report(worker="judge-1", lease_id="x", epoch=1, result=Failure(message="", unread=(there, gone)))
    assert look(store, told) == f"blob {gone.digest[:16]} is missing"
    only = msgspec.structs.replace(told, result=Failure(message="", unread=(there,)))
    assert look(store, only) == "", "it is there: the worker is at fault"


def test_a_disk_that_takes_nothing_is_no_fault_of_the_result(store: BlobFolder, left: WorkerFolder) -> None:
    told = report(left)
    assert isinstance(told.result, FlyResult)
    assert told.result.flight.trace is not None
    store.path(told.result.flight.trace.digest).parent.write_text("a file where the folder should be")
    assert look(store, told) is None


@pytest.mark.parametrize("trouble", [None, Trouble(loss=0.2, duplicate=0.2, delay_max_s=0.5)])
def test_blobs_get_over_the_bus_both_ways(store: BlobFolder, trouble: Trouble | None) -> None:
    network = MemoryNetwork() if trouble is None else FaultyNetwork(3, trouble)
    blobs, bus = connected(network, store)
    data = derive(2, "blob").bytes(5 * MIB + 17)
    ref = blobs.put(data)
    assert store.adopt("fly-1", ref) == ""
    assert blobs.get(ref) == data
    assert bus.questions >= 2 * 6
    with pytest.raises(BlobMissing):
        blobs.get(ref_of(b"never left"))


@dataclass
class Asked:
    """A question that is answered at once."""

    key: str
    payload: bytes
    answers: list[bytes]
    sender: str = "fly-1"
    peer: str = ""
    damaged: str = ""

    def reply(self, payload: bytes) -> None:
        self.answers.append(payload)

    def refuse(self, words: str) -> None:
        raise AssertionError(words)


class SlowLine:
    """A way to the books of so many bytes a second, one message after the other: what comes late comes all the same."""

    def __init__(self, requests: BlobRequests, bytes_per_s: float) -> None:
        self._requests, self._rate = requests, bytes_per_s
        self._now_s = self._free_s = 0.0
        self.carried_bytes = 0

    def ask(self, key: str, payload: bytes, tag: Hashable, inbox: Inbox, timeout_s: float) -> None:
        answers: list[bytes] = []
        self._requests.answer(Asked(key, payload, answers))
        size = len(payload) + sum(map(len, answers))
        self.carried_bytes += size
        self._free_s = max(self._now_s, self._free_s) + size / self._rate
        in_time = self._free_s <= self._now_s + timeout_s
        self._now_s = self._free_s if in_time else self._now_s + timeout_s
        inbox(Reply(tag, answers[0] if in_time else None))

    def monotonic_s(self) -> float:
        return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        self._now_s += duration_s


@pytest.mark.parametrize("kbit_per_s", [16, 64, 256, 2_000, 1_000_000])
def test_a_slow_line_carries_blobs_too(store: BlobFolder, kbit_per_s: int) -> None:
    """A chunk of fixed size in a fixed time is a line rate that everybody must have."""
    line = SlowLine(BlobRequests(store), kbit_per_s * 125)
    blobs = BusBlobs(line, "c", "fly-1", line)  # type: ignore[arg-type]
    data = derive(4, "blob").bytes(3 * MIB)
    ref = blobs.put(data)
    assert store.adopt("fly-1", ref) == ""
    assert line.carried_bytes < 1.2 * len(data), "what is under way is not sent once more"
    assert blobs.get(ref) == data
    fresh = BusBlobs(line, "c", "fly-1", line)  # type: ignore[arg-type]
    assert fresh.get(ref) == data, "it has not learnt the rate yet"


def test_a_trace_larger_than_a_message_travels_in_chunks(store: BlobFolder) -> None:
    blobs, bus = connected(MemoryNetwork(), store)
    noise = derive(3, "noise").random(MIB, dtype=np.float32).tobytes()
    big = Trace(step_s=0.01, signals={f"signal_{number}_m": noise for number in range(10)})
    told = report(blobs, big)
    assert isinstance(told.result, FlyResult)
    trace = told.result.flight.trace
    assert trace is not None
    assert trace.size_bytes > MESSAGE_BYTES_MAX
    assert look(store, told) == ""
    assert unpack_trace(blobs.get(trace), told.result.flight.trace_digest).signals["signal_9_m"] == noise
    assert bus.largest_bytes < CHUNK_BYTES_MAX + 1000


def test_books_that_refuse_or_are_silent_make_it_unavailable(store: BlobFolder) -> None:
    blobs, _ = connected(MemoryNetwork(), store, worker="..")
    with pytest.raises(Unavailable, match="refused by the books"):
        blobs.put(b"x")
    network = MemoryNetwork()
    bus = SteppedBus(network, "fly-1")
    with pytest.raises(Unavailable, match="did not answer"):
        BusBlobs(bus, "c", "fly-1", bus).get(ref_of(b"x"))  # type: ignore[arg-type]


def test_a_worker_that_sees_the_folder_uses_it_and_others_the_bus(store: BlobFolder, tmp_path: Path) -> None:
    blobs, bus = connected(MemoryNetwork(), store)
    beside = WorkerBlobs(blobs, "fly-1", tmp_path / "run", ())
    assert bus.questions == 0, "nothing is asked before a lease needs it"
    first = beside.put(b"in the folder")
    asked = bus.questions
    assert store.adopt("fly-1", first) == ""
    assert beside.get(first) == b"in the folder"
    assert bus.questions == asked == 1
    BlobFolder(tmp_path / "elsewhere").make_probe()
    for place in (None, tmp_path / "nowhere", tmp_path / "elsewhere"):
        away = WorkerBlobs(blobs, "fly-1", place, ())
        assert away.get(first) == b"in the folder"
    assert bus.questions > asked + 3


def test_a_new_life_keeps_only_what_is_still_to_be_reported(store: BlobFolder, tmp_path: Path) -> None:
    blobs, _ = connected(MemoryNetwork(), store)
    before = WorkerBlobs(blobs, "fly-1", tmp_path / "run", ())
    told, lost = report(before), before.put(b"of a flight never reported")
    again = WorkerBlobs(blobs, "fly-1", tmp_path / "run", (told,))
    again.put(b"new")
    assert look(store, told) == ""
    assert store.adopt("fly-1", lost) == "missing"


def test_who_leaves_too_much_is_refused_and_told_of(store: BlobFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quota, "WORKER_BYTES_MAX", 3 * MIB)
    network, told = MemoryNetwork(), list[tuple[str, str]]()
    requests = BlobRequests(store)
    requests.on_excess = lambda where, words: told.append((where, words))
    network.connect("books").serve("saflite/2/c/blob/*", requests.answer)
    bus = SteppedBus(network, "fly-1")
    blobs = BusBlobs(bus, "c", "fly-1", bus)  # type: ignore[arg-type]
    blobs.put(bytes(2 * MIB))
    with pytest.raises(Unavailable, match=r"refused by the books: .* would wait for the books"):
        blobs.put(bytes(2 * MIB + 1))
    assert told
    assert told[0][0] == "fly-1 on blob"
    assert "more than the 3145728 bytes" in told[0][1]
