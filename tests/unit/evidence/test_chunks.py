"""Blobs in chunks: bounded steps, taken up where they stopped, checked on both sides."""

from __future__ import annotations

from pathlib import Path

import pytest

from saflite.contract.blobs import BlobChunk, BlobGet, BlobMissing, BlobPut, BlobRef, BlobTaken, ref_of
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.rng import derive
from saflite.evidence import chunks, quota
from saflite.evidence.chunks import ChunkServer, Download, OverQuota, Upload
from saflite.evidence.folder import BlobFolder, WorkerFolder

DATA = derive(1, "blob").bytes(10_500)


@pytest.fixture
def folder(tmp_path: Path) -> BlobFolder:
    return BlobFolder(tmp_path)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "CHUNK_BYTES_MAX", 1000)


def upload(server: ChunkServer, data: bytes, steps: int = 10**6) -> Upload:
    way = Upload("fly-1", ref_of(data), data)
    while steps and (ask := way.ask()) is not None:
        assert len(ask.data) <= 1000
        way.take(server.put(ask))
        steps -= 1
    return way


def download(server: ChunkServer, ref: BlobRef) -> bytes:
    way = Download(ref)
    while (ask := way.ask()) is not None:
        way.take(server.get(BlobGet(digest=ask.digest, offset=ask.offset, length=1000)))
    return way.result()


@pytest.mark.parametrize("size", [0, 1, 999, 1000, 1001, 10_500])
def test_what_is_left_in_chunks_is_adopted_and_read_in_chunks(folder: BlobFolder, size: int) -> None:
    server, data = ChunkServer(folder), DATA[:size]
    upload(server, data)
    assert folder.adopt("fly-1", ref_of(data)) == ""
    assert download(server, ref_of(data)) == data


def test_an_upload_goes_on_where_it_stopped(folder: BlobFolder) -> None:
    server = ChunkServer(folder)
    upload(server, DATA, steps=5)
    again = Upload("fly-1", ref_of(DATA), DATA)
    first = again.ask()
    assert first is not None
    assert server.put(first).have_bytes == 4000
    upload(server, DATA)
    assert server.put(first).have_bytes == len(DATA), "all of it is there, and nothing more is sent"
    assert folder.adopt("fly-1", ref_of(DATA)) == ""


def test_a_stretch_sent_twice_or_out_of_order_does_no_harm(folder: BlobFolder) -> None:
    server, ref = ChunkServer(folder), ref_of(DATA)

    def put(at: int) -> int:
        return server.put(BlobPut(worker="fly-1", ref=ref, offset=at, data=DATA[at : at + 1000])).have_bytes

    assert [put(at) for at in (0, 0, 5000, 1000, 0)] == [1000, 1000, 1000, 2000, 2000]
    upload(server, DATA)
    assert folder.adopt("fly-1", ref) == ""


def test_other_bytes_than_the_digest_names_are_refused_at_the_end(folder: BlobFolder) -> None:
    server, ref = ChunkServer(folder), ref_of(b"a" * 10)
    with pytest.raises(Refused, match="bytes with the digest"):
        server.put(BlobPut(worker="fly-1", ref=ref, data=b"b" * 10))
    assert server.put(BlobPut(worker="fly-1", ref=ref)).have_bytes == 0
    assert folder.adopt("fly-1", ref) == "missing"


@pytest.mark.parametrize(
    ("offset", "data"), [(-1, b""), (0, b"x" * 1001), (9, b"xx"), (11, b""), (2**62, b"")], ids=str
)
def test_stretches_that_make_no_sense_are_refused(folder: BlobFolder, offset: int, data: bytes) -> None:
    size = 2000 if len(data) > 1000 else 10
    ref = BlobRef(digest="0" * 64, size_bytes=size)
    with pytest.raises(Refused, match="blob"):
        ChunkServer(folder).put(BlobPut(worker="fly-1", ref=ref, offset=offset, data=data))


@pytest.mark.parametrize(("offset", "length"), [(-1, 10), (0, 0), (0, -1), (0, 1001)])
def test_questions_that_make_no_sense_are_refused(folder: BlobFolder, offset: int, length: int) -> None:
    with pytest.raises(Refused, match="an offset"):
        ChunkServer(folder).get(BlobGet(digest="0" * 64, offset=offset, length=length))


@pytest.mark.parametrize("name", ["../../../etc/passwd", "a" * 63 + "/"])
def test_no_name_becomes_a_path_unchecked(folder: BlobFolder, name: str) -> None:
    server = ChunkServer(folder)
    with pytest.raises(Refused, match="digest"):
        server.get(BlobGet(digest=name, offset=0, length=1))
    with pytest.raises(Refused, match="digest"):
        server.put(BlobPut(worker="fly-1", ref=BlobRef(digest=name, size_bytes=1), data=b"x"))
    with pytest.raises(Refused, match="worker"):
        server.put(BlobPut(worker="../x", ref=ref_of(b"x"), data=b"x"))


def test_a_blob_that_is_not_there_or_damaged_is_said_on_the_other_side(folder: BlobFolder) -> None:
    server, ref = ChunkServer(folder), folder.put(DATA)
    folder.path(ref.digest).write_bytes(b"\0" + DATA[1:])
    with pytest.raises(BlobMissing, match="is damaged"):
        download(server, ref)
    folder.path(ref.digest).write_bytes(DATA[:-1])
    with pytest.raises(BlobMissing, match="is damaged"):
        download(server, ref)
    folder.path(ref.digest).unlink()
    with pytest.raises(BlobMissing, match="is missing"):
        download(server, ref)


def test_a_server_that_gives_nothing_more_or_forgets_again_and_again_is_left() -> None:
    way = Download(ref_of(DATA))
    way.take(BlobChunk(size_bytes=len(DATA), data=DATA[:1000]))
    with pytest.raises(BlobMissing, match="is damaged"):
        way.take(BlobChunk(size_bytes=len(DATA)))
    up = Upload("fly-1", ref_of(DATA), DATA)
    for turn in range(2 * chunks.RESTARTS_MAX + 1):
        up.take(BlobTaken(have_bytes=1000 * ((turn + 1) % 2)))
    up.take(BlobTaken(have_bytes=1000))
    with pytest.raises(Unavailable, match="is not taken"):
        up.take(BlobTaken(have_bytes=0))
    with pytest.raises(Unavailable, match="is not taken"):
        Upload("fly-1", ref_of(DATA), DATA).take(BlobTaken(have_bytes=10**9))


@pytest.mark.parametrize("sent", [len(DATA) - 999, len(DATA) + 1, 10**6])
def test_a_server_that_sends_beyond_the_end_is_left_at_once(sent: int) -> None:
    """It was asked on and on, and its answers kept."""
    way = Download(ref_of(DATA))
    way.take(BlobChunk(size_bytes=len(DATA), data=DATA[:1000]))
    with pytest.raises(BlobMissing, match="is damaged"):
        way.take(BlobChunk(size_bytes=len(DATA), data=bytes(sent)))
    empty = Download(ref_of(b""))
    with pytest.raises(BlobMissing, match="is damaged"):
        empty.take(BlobChunk(size_bytes=0, data=b"x"))


def test_a_disk_that_takes_nothing_is_unavailable(tmp_path: Path) -> None:
    (tmp_path / "blobs").write_text("a file where the folder should be")
    with pytest.raises(Unavailable, match="takes no blob"):
        ChunkServer(BlobFolder(tmp_path)).put(BlobPut(worker="fly-1", ref=ref_of(b"x"), data=b"x"))


# ---- what may wait -------------------------------------------------------------------------------------------------


def test_a_worker_that_leaves_too_much_is_refused_in_words_until_the_books_have_answered(
    folder: BlobFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quota, "WORKER_BYTES_MAX", 20_000)
    server = ChunkServer(folder)
    upload(server, DATA)
    with pytest.raises(OverQuota, match="bytes in 1 files of fly-1 would wait for the books"):
        upload(server, DATA[:-1])
    folder.forget("fly-1", [ref_of(DATA).digest])
    upload(server, DATA[:-1])
    other = BlobPut(worker="fly-2", ref=ref_of(DATA[:-1]), offset=0, data=DATA[:1000])
    assert server.put(other).have_bytes == 1000, "another worker has room of its own"


def test_a_worker_that_takes_a_new_name_for_each_blob_does_not_fill_the_disk(
    folder: BlobFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quota, "ALL_BYTES_MAX", 50_000)
    server = ChunkServer(folder)

    def begin(number: int) -> None:
        data = DATA[:-number]
        server.put(BlobPut(worker=f"w{number}", ref=ref_of(data), offset=0, data=data[:1000]))

    for number in range(1, 41):
        begin(number)
    with pytest.raises(OverQuota, match="of all workers"):
        begin(41)


def test_a_worker_in_the_folder_is_told_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quota, "WORKER_BYTES_MAX", 15_000)
    worker = WorkerFolder(tmp_path, "fly-1")
    worker.put(DATA)
    with pytest.raises(Unavailable, match="would wait for the books"):
        worker.put(DATA[:-1])
