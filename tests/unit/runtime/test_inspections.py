"""Looking at blobs takes long, so only results that may count have theirs looked at, and each once at a time."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from saflite.contract import topics
from saflite.contract.blobs import BLOBS_PER_RESULT_MAX, RESULT_BYTES_MAX, BlobRef
from saflite.contract.flight import Artefact, Flight
from saflite.contract.work import Failure, FlyResult, Receipt, Report
from saflite.evidence.folder import BlobFolder, WorkerFolder
from saflite.runtime.evidence import Then, look

from .test_books_service import Stand, _mutated, stand

__all__ = ["stand"]

BLOB = BlobRef(digest="0" * 64, size_bytes=6)


class SlowEvidence:
    """Ends what it was asked to look at when told to."""

    def __init__(self) -> None:
        self.under_way: list[tuple[Report, Then]] = []

    def inspect(self, report: Report, then: Then) -> None:
        self.under_way.append((report, then))

    def answered(self, report: Report) -> None:
        """Nothing was left."""


@pytest.fixture
def slow(stand: Stand) -> SlowEvidence:
    evidence = SlowEvidence()
    stand.service._evidence = evidence
    return evidence


def flown(*blobs: BlobRef) -> FlyResult:
    named = tuple(Artefact(name=f"a{place}", blob=blob) for place, blob in enumerate(blobs))
    return FlyResult(flight=Flight(test_case="0" * 16, flight_index=0, ending="completed", artefacts=named))


def test_a_result_without_a_lease_is_answered_and_its_blobs_are_not_looked_at(stand: Stand, slow: SlowEvidence) -> None:
    held = _mutated(stand)
    for report in (
        msgspec.structs.replace(held, lease_id="no:such-lease", result=flown(BLOB)),
        msgspec.structs.replace(held, epoch=held.epoch + 1, result=flown(BLOB)),
        msgspec.structs.replace(held, result=flown(*[BLOB] * BLOBS_PER_RESULT_MAX, BLOB)),
        msgspec.structs.replace(held, result=flown(msgspec.structs.replace(BLOB, size_bytes=RESULT_BYTES_MAX), BLOB)),
    ):
        many = len(stand.answers)
        stand.send(topics.result("c", "fly"), report)
        assert len(stand.answers) == many + 1
        assert stand.last(Receipt).status in ("refused", "stale")
    assert slow.under_way == []


def test_a_result_sent_again_is_looked_at_once_and_its_latest_sender_is_answered(
    stand: Stand, slow: SlowEvidence
) -> None:
    report = msgspec.structs.replace(_mutated(stand), result=flown(BLOB))
    stand.answers.clear()
    for _ in range(3):
        stand.send(topics.result("c", "mutate"), report)
    assert stand.answers == []
    ((_, then),) = slow.under_way
    then("")
    stand.turn()
    assert [stand.last(Receipt).status] == ["refused"], "a flight, for what was to be mutated"
    assert len(stand.answers) == 1


def test_a_failure_that_names_blobs_its_work_does_not_is_taken_at_once_and_they_are_not_looked_at(
    stand: Stand, slow: SlowEvidence
) -> None:
    report = msgspec.structs.replace(_mutated(stand), result=Failure(message="unread", unread=(BLOB,)))
    stand.answers.clear()
    stand.send(topics.result("c", "mutate"), report)
    assert [stand.last(Receipt).status] == ["accepted"]
    assert slow.under_way == []


def test_a_blob_named_many_times_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, read = BlobFolder(tmp_path / "run"), list[str]()
    blob = WorkerFolder(tmp_path / "run", "fly-1").put(b"honest")
    report = Report(worker="fly-1", lease_id="r:x", epoch=1, result=flown(*[blob] * BLOBS_PER_RESULT_MAX))
    adopt = BlobFolder.adopt

    def noting(self: BlobFolder, worker: str, blob: BlobRef) -> str:
        read.append(blob.digest)
        return adopt(self, worker, blob)

    monkeypatch.setattr(BlobFolder, "adopt", noting)
    assert look(store, report) == ""
    assert read == [blob.digest]
