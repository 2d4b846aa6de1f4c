"""The store of blobs: named by their bytes, adopted once checked, dropped only by the books."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from saflite.contract.blobs import BlobMissing, BlobPut, BlobRef, Blobs, ref_of
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.ids import digest
from saflite.evidence import files
from saflite.evidence.chunks import ChunkServer
from saflite.evidence.folder import BlobFolder, WorkerFolder
from saflite.evidence.memory import MemoryBlobs

DATA = bytes(range(256)) * 10


@pytest.fixture(params=["memory", "folder"])
def blobs(request: pytest.FixtureRequest, tmp_path: Path) -> Blobs:
    return MemoryBlobs() if request.param == "memory" else BlobFolder(tmp_path)


def test_what_is_put_is_got(blobs: Blobs) -> None:
    for data in (DATA, b"", b"\0"):
        ref = blobs.put(data)
        assert ref == BlobRef(digest=digest(data), size_bytes=len(data))
        assert blobs.get(ref) == data
        assert blobs.put(data) == ref


def test_what_is_not_there_is_missing(blobs: Blobs) -> None:
    with pytest.raises(BlobMissing, match="is missing"):
        blobs.get(ref_of(DATA))


@pytest.mark.parametrize("name", ["../../etc/passwd", "A" * 64, "0" * 63, "", "0" * 63 + "\n"])
def test_a_reference_that_cannot_be_one_is_refused(blobs: Blobs, name: str) -> None:
    with pytest.raises(Refused, match="expected a digest"):
        blobs.get(BlobRef(digest=name, size_bytes=1))


@pytest.mark.parametrize("name", ["", "..", ".hidden", "a/b", "a" * 65, "a\0", "a b", "ä"])
def test_a_name_that_cannot_be_a_folder_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(Refused, match="worker name"):
        BlobFolder(tmp_path).adopt(name, ref_of(DATA))


def test_what_a_worker_leaves_is_in_the_store_once_it_is_adopted(tmp_path: Path) -> None:
    store, worker = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1")
    ref = worker.put(DATA)
    with pytest.raises(BlobMissing):
        store.get(ref)
    assert store.adopt("fly-2", ref) == "missing"
    assert store.adopt("fly-1", ref) == ""
    assert (store.get(ref), worker.get(ref)) == (DATA, DATA)
    store.forget("fly-1", [ref.digest])
    assert store.get(ref) == DATA
    assert store.adopt("fly-1", ref) == "", "a result sent twice finds what the first one left"
    store.drop([ref.digest])
    assert store.adopt("fly-1", ref) == "missing"


@pytest.mark.parametrize("damage", [b"", DATA[:-1], b"\1" + DATA[1:], DATA + b"x"])
def test_nothing_damaged_is_adopted(tmp_path: Path, damage: bytes) -> None:
    store, worker = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1")
    ref = worker.put(DATA)
    (store.incoming("fly-1") / ref.digest).write_bytes(damage)
    assert store.adopt("fly-1", ref) != ""
    assert list(store.digests()) == []


def test_a_blob_damaged_in_the_store_is_noticed_and_mended_by_the_next_one(tmp_path: Path) -> None:
    store, worker = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1")
    ref = store.put(DATA)
    store.path(ref.digest).write_bytes(b"\1" + DATA[1:])
    assert (store.fault(ref), store.fault(ref, deep=True)) == ("", "damaged")
    with pytest.raises(BlobMissing, match="is damaged"):
        store.get(ref)
    worker.put(DATA)
    assert store.adopt("fly-1", ref) == ""
    assert store.get(ref) == DATA


def test_dropping_a_blob_leaves_the_one_another_worker_has_left_meanwhile(tmp_path: Path) -> None:
    store, first, second = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1"), WorkerFolder(tmp_path, "fly-2")
    ref = first.put(DATA)
    store.adopt("fly-1", ref)
    second.put(DATA)
    store.drop([ref.digest])
    assert store.adopt("fly-2", ref) == ""


def test_opening_removes_what_nobody_needs_and_nothing_else(tmp_path: Path) -> None:
    store, worker = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1")
    kept, orphan, waiting = store.put(b"kept"), store.put(b"orphan"), worker.put(b"waiting")
    store.path(kept.digest).with_name("torn.part").write_bytes(b"ke")
    store.keep_only(frozenset([kept.digest]))
    assert list(store.digests()) == [kept.digest]
    assert not list(tmp_path.rglob("*.part"))
    assert store.adopt("fly-1", waiting) == ""
    assert orphan.digest not in set(store.digests())


def test_a_worker_begins_with_what_it_still_has_to_report(tmp_path: Path) -> None:
    store, worker = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1")
    spooled, lost = worker.put(b"spooled"), worker.put(b"lost")
    (store.incoming("fly-1") / "torn.part").write_bytes(b"x")
    store.forget_but("fly-1", [spooled.digest])
    assert [path.name for path in store.incoming("fly-1").iterdir()] == [spooled.digest]
    assert store.adopt("fly-1", lost) == "missing"


def test_only_who_reads_the_probe_sees_the_folder(tmp_path: Path) -> None:
    store = BlobFolder(tmp_path / "run")
    probe = store.make_probe()
    assert store.make_probe() == probe
    assert WorkerFolder.sees(tmp_path / "run", "fly-1", probe)
    assert not WorkerFolder.sees(tmp_path / "other", "fly-1", probe)
    BlobFolder(tmp_path / "other").make_probe()
    assert not WorkerFolder.sees(tmp_path / "other", "fly-1", probe)


def test_a_file_system_without_links_gets_a_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(source: object, place: object) -> None:
        raise PermissionError("no links here")

    monkeypatch.setattr(os, "link", refuse)
    store, worker = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1")
    ref = worker.put(DATA)
    assert store.adopt("fly-1", ref) == ""
    store.forget("fly-1", [ref.digest])
    assert store.get(ref) == DATA


def test_a_disk_that_takes_nothing_is_unavailable(tmp_path: Path) -> None:
    (tmp_path / "blobs").write_text("a file where the folder should be")
    with pytest.raises(Unavailable, match="takes no blob"):
        BlobFolder(tmp_path).put(DATA)
    with pytest.raises(Unavailable, match="takes no blob"):
        WorkerFolder(tmp_path, "fly-1").put(DATA)


def test_linking_over_what_is_there_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"a")
    (tmp_path / "b").write_bytes(b"b")
    files.put_in_place(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").read_bytes() == b"b"


def _left(tmp_path: Path) -> list[Path]:
    return list((tmp_path / "blobs" / "incoming").glob("*"))


def test_folders_of_those_who_were_answered_stay_but_for_all_too_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("saflite.evidence.folder.EMPTY_MAX", 3)
    folder = BlobFolder(tmp_path)
    for number in (0, 1, 2, 3, 1, 4):
        worker = WorkerFolder(tmp_path, f"fly-{number}")
        folder.forget(f"fly-{number}", [worker.put(b"a flight").digest])
    assert {path.name for path in _left(tmp_path)} == {"fly-3", "fly-1", "fly-4"}
    BlobFolder(tmp_path).keep_only(frozenset())
    assert not _left(tmp_path)


@pytest.mark.parametrize("way", ["begun-anew", "wrong-bytes"])
def test_no_folder_stays_of_a_worker_that_leaves_nothing(tmp_path: Path, way: str) -> None:
    folder = BlobFolder(tmp_path)
    server = ChunkServer(folder)
    for number in range(20):
        worker, data = f"evil-{number}", b"evil"
        if way == "wrong-bytes":
            with pytest.raises(Refused, match="digest"):
                server.put(BlobPut(worker=worker, ref=ref_of(b"good"), data=data))
            continue
        server.put(BlobPut(worker=worker, ref=ref_of(data), data=data))
        folder.forget_but(worker, ())
    assert not _left(tmp_path)


def test_what_a_worker_still_has_to_report_keeps_its_folder(tmp_path: Path) -> None:
    folder = BlobFolder(tmp_path)
    worker = WorkerFolder(tmp_path, "fly-1")
    one, other = worker.put(b"one"), worker.put(b"other")
    folder.forget("fly-1", [one.digest])
    folder.forget_but("fly-1", [other.digest])
    assert not folder.adopt("fly-1", other)


def test_a_folder_that_is_removed_while_a_worker_writes_is_made_again(tmp_path: Path) -> None:
    """The books remove it whenever they find it empty, also right after the worker has made it."""
    folder, worker = BlobFolder(tmp_path), WorkerFolder(tmp_path, "fly-1")
    over = threading.Event()

    def keep_removing() -> None:
        while not over.wait(0.0002):
            files.remove_if_empty(folder.incoming("fly-1"))

    thread = threading.Thread(target=keep_removing)
    thread.start()
    try:
        for number in range(1000):
            ref = worker.put(str(number).encode())
            assert not folder.adopt("fly-1", ref)
            folder.forget("fly-1", [ref.digest])
    finally:
        over.set()
        thread.join()


@pytest.mark.parametrize("below", ["run", "runs/night"])
def test_a_run_folder_that_was_moved_away_is_not_made_again(below: str, tmp_path: Path) -> None:
    """Who is told to put it back would put it into the new one."""
    place = tmp_path / below
    place.mkdir(parents=True)
    store, worker, chunks = BlobFolder(place), WorkerFolder(place, "fly-1"), ChunkServer(BlobFolder(place))
    part = BlobPut(worker="fly-2", ref=ref_of(DATA), offset=0, data=DATA)
    store.make_probe()
    worker.put(DATA)
    place.rename(tmp_path / "moved")
    for write in (lambda: worker.put(DATA), lambda: store.put(DATA), store.make_probe, lambda: chunks.put(part)):
        with pytest.raises(Unavailable):
            write()
    assert not place.exists()
    (tmp_path / "moved").rename(place)
    worker.put(DATA)
    assert chunks.put(part).have_bytes == len(DATA)
