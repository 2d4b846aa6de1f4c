"""What may wait for the books: exact for a worker, counted now and then for all."""

from __future__ import annotations

from pathlib import Path

import pytest

from saflite.bus.access import Peer
from saflite.bus.keyring import Register
from saflite.evidence import quota
from saflite.evidence.folder import BlobFolder

KIB = 1024


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Return the list of folders under which all was counted, growing."""
    looks: list[Path] = []
    whole = quota._folders

    def look(incoming: Path) -> list[str]:
        looks.append(incoming)
        return whole(incoming)

    monkeypatch.setattr(quota, "_folders", look)
    return looks


def leave(folder: BlobFolder, worker: str, name: str, size_bytes: int) -> None:
    path = folder.incoming(worker) / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(size_bytes))


def test_not_every_blob_has_the_folders_of_all_workers_looked_through(tmp_path: Path, looks: list[Path]) -> None:
    folder = BlobFolder(tmp_path)
    writer = folder.quota()
    for number in range(300):
        assert not writer.excess("fly-1", 100 * KIB), "nothing of it stays"
        assert not folder.quota().excess(f"fly-{number}", 100 * KIB), "a worker's first ones need no look at others"
    assert 0 < len(looks) < 10


def test_writers_that_count_apart_pass_the_limit_of_all_by_less_than_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quota, "ALL_BYTES_MAX", 100 * KIB)
    folder, left = BlobFolder(tmp_path), 0
    for number in range(20):
        writer = folder.quota()
        for blob in range(20):
            if not writer.excess(f"w{number}", KIB // 2):
                leave(folder, f"w{number}", str(blob), KIB // 2)
                left += KIB // 2
    assert 100 * KIB <= left + KIB < 200 * KIB


def test_one_refused_for_all_may_again_once_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quota, "ALL_BYTES_MAX", 10 * KIB)
    folder = BlobFolder(tmp_path)
    writer = folder.quota()
    leave(folder, "w1", "a", 9 * KIB)
    for _ in range(3):
        assert "of all workers would wait" in writer.excess("w2", 2 * KIB)
    folder.forget("w1", ["a"])
    assert not writer.excess("w2", 2 * KIB)


def test_files_of_all_count_as_well_as_their_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quota, "FILES_MAX", 20)
    folder = BlobFolder(tmp_path)
    for number in range(21):
        leave(folder, f"w{number}", "a", 0)
    assert "21 files of all workers" in folder.quota().excess("x", 1)


def test_a_folder_without_files_counts_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quota, "FILES_MAX", 20)
    folder = BlobFolder(tmp_path)
    for number in range(21):
        folder.incoming(f"w{number}").mkdir(parents=True)
    assert "21 files of all workers" in folder.quota().excess("x", 1)


def test_one_worker_leaves_no_more_files_than_are_quickly_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quota, "WORKER_FILES_MAX", 20)
    folder = BlobFolder(tmp_path)
    for number in range(21):
        assert not folder.quota().excess("w", 1)
        leave(folder, "w", str(number), 0)
    assert "21 files of w would wait" in folder.quota().excess("w", 1)
    assert not folder.quota().excess("x", 1)


def fill(folder: BlobFolder, writer: quota.Quota, workers: list[str]) -> int:
    """Leave blobs of half a KiB in turn until none may leave more; return how many bytes it were."""
    left, going = 0, list(workers)
    while going:
        for worker in tuple(going):
            if writer.excess(worker, KIB // 2):
                going.remove(worker)
            else:
                leave(folder, worker, str(left), KIB // 2)
                left += KIB // 2
    return left


def test_no_key_fills_the_room_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under any number of names; the farm's own have all that is left."""
    monkeypatch.setattr(quota, "ALL_BYTES_MAX", 120 * KIB)
    folder = BlobFolder(tmp_path)
    writer = folder.quota()
    writer.key_of = lambda worker: "" if worker.startswith("fly") else worker.rpartition("-")[0]
    one = fill(folder, writer, [f"eve-{number}" for number in range(9)])
    assert 59 * KIB <= one <= 60 * KIB, "half"
    assert "workers of key eve would wait" in writer.excess("eve-10", KIB)
    other = fill(folder, writer, [f"lab-{number}" for number in range(9)])
    assert 29 * KIB <= other <= 30 * KIB, "half of the rest"
    assert fill(folder, writer, ["fly-1", "fly-2"]) >= 29 * KIB
    folder.forget("eve-0", [path.name for path in folder.incoming("eve-0").iterdir()])
    assert not writer.excess("fly-1", KIB), "there is room again"


def test_files_are_shared_among_keys_as_bytes_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quota, "FILES_MAX", 40)
    folder = BlobFolder(tmp_path)
    writer = folder.quota()
    writer.key_of = lambda worker: worker.rpartition("-")[0]
    assert 18 <= fill(folder, writer, [f"eve-{number}" for number in range(100)]) // (KIB // 2) <= 21
    assert not writer.excess("lab-1", 1)


def test_what_the_workers_of_a_revoked_key_left_takes_no_room_of_others(tmp_path: Path) -> None:
    """They were cut off in the middle of it: nobody goes on with it, and nobody answers for it."""
    peers = tuple(Peer(name=name, roles=("worker",), revoked=name == "lab2") for name in ("lab2", "lab2-b", "site"))
    register, folder = Register(hosts=(), peers=peers), BlobFolder(tmp_path)
    key_of, left = register.key_of(), ("lab2", "lab2-0a1b2c-fly-1", "lab2-b-0a1b2c-fly-1", "site-fly-1", "fly-1")
    for worker in left:
        leave(folder, worker, "0" * 64 + ".part", KIB)
    folder.forget_all_of(lambda worker: register.is_revoked(key_of(worker)))
    assert sorted(path.name for path in (tmp_path / "blobs" / "incoming").iterdir()) == sorted(left[2:])
