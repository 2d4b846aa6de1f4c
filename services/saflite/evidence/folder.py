"""The store of a run's blobs: one folder, each blob a file named by its digest, `blobs/ab/abcdef...`.

Workers never write there. What they leave stands under `blobs/incoming/WORKER/` until the books adopt it: adopting
checks the digest once and lets the file stand in the store under a second name. So nobody can find a blob "already
there" that the books are about to drop, and what a worker has not been given a receipt for survives a crash of the
books, who remove from the store whatever their journal does not hold.

Only blobs that are kept for good are flushed. The others are needed until they are judged; one that a power failure
takes is noticed by its digest when the books are opened, and flown again.
"""

from __future__ import annotations

import os
import secrets
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from shutil import rmtree

from saflite.contract.blobs import BlobRef, check_digest, check_ref, ref_of
from saflite.contract.errors import Unavailable
from saflite.contract.join import check_worker_name
from saflite.evidence import files
from saflite.evidence.quota import Quota

BLOBS = "blobs"
INCOMING = "incoming"
PROBE = "probe"
EMPTY_MAX = 1_000  # folders of workers: to remove and make one for each blob costs more than the blob


class BlobFolder:
    """The blobs of one run, seen from the side of the books. Makes no folder until something is written."""

    def __init__(self, run_dir: Path) -> None:
        self.within = run_dir if run_dir.is_dir() else None  # one that was there is not made again: it was moved
        self._folder = run_dir / BLOBS
        self._probe = ""
        self._answering = threading.Lock()
        self._answered: dict[str, str] = {}  # what workers left in these folders was dealt with; the latest last

    def path(self, digest: str) -> Path:
        """Return where a blob stands; raises Refused for a digest that cannot be one, as tables of others may have."""
        return Path(self._place(digest))

    def _place(self, digest: str) -> str:
        """As `path`, without what taking paths apart costs for each of many blobs."""
        check_digest(digest)
        return f"{self._folder}/{digest[:2]}/{digest}"

    def incoming(self, worker: str) -> Path:
        """Return the folder of what a worker leaves; raises Refused for a name that cannot be one."""
        return Path(self._left(worker))

    def _left(self, worker: str) -> str:
        """As `incoming`; see `_place`."""
        return f"{self._folder}/{INCOMING}/{check_worker_name(worker)}"

    def quota(self) -> Quota:
        """Return what may still be left there, for one that lets it be left."""
        return Quota(self._folder / INCOMING)

    # ---- for workers in the same process, and for readers --------------------------------------------------------

    def put(self, data: bytes) -> BlobRef:
        """See `Blobs.put`: straight into the store."""
        ref = ref_of(data)
        if self.fault(ref):
            files.write_whole(self.path(ref.digest), data, self.within)
        return ref

    def get(self, ref: BlobRef) -> bytes:
        """See `Blobs.get`."""
        check_ref(ref)
        return files.read_whole(self.path(ref.digest), ref)

    def fault(self, ref: BlobRef, *, deep: bool = False) -> str:
        """Return `missing`, `damaged` or, where all is well, nothing; `deep` reads and checks every byte."""
        return files.fault_of(self._place(ref.digest), ref, deep=deep)

    def digests(self) -> Iterator[str]:
        """Yield the digests of all blobs in the store, sorted."""
        for folder in sorted(self._folder.glob("[0-9a-f][0-9a-f]")):
            yield from sorted(path.name for path in folder.iterdir() if path.suffix != files.PART)

    # ---- taking in what workers leave ----------------------------------------------------------------------------

    def adopt(self, worker: str, ref: BlobRef) -> str:
        """Take a blob a worker has left into the store, its digest checked; returns its fault, empty if it has none.

        Raises:
            Refused: the reference or the name cannot be one.
            Unavailable: the disk does not take it.
        """
        check_ref(ref)
        left, place = f"{self._left(worker)}/{ref.digest}", self._place(ref.digest)
        fault = files.fault_of(left, ref, deep=True)
        if fault:
            return self.fault(ref, deep=True)  # a result sent twice: it was adopted the first time
        if not files.put_in_place(left, place) and self.fault(ref, deep=True):
            self.drop([ref.digest])
            files.put_in_place(left, place)
        return ""

    def forget(self, worker: str, digests: Iterable[str]) -> None:
        """Remove what a worker has left, now that the books have answered for it; its folder stays for the next.

        Of the workers who left nothing since, the folders of the latest stay.
        """
        folder = self._left(worker)
        for digest in digests:
            with suppress(OSError):
                os.unlink(f"{folder}/{digest}")
        with self._answering:
            self._answered.pop(worker, None)
            self._answered[worker] = folder
            if len(self._answered) > EMPTY_MAX:
                files.remove_if_empty(self._answered.pop(next(iter(self._answered))))

    def forget_but(self, worker: str, keep: Iterable[str]) -> None:
        """Remove what a worker has left in an earlier life, but for what it still has to report."""
        kept, folder = set(keep), self.incoming(worker)
        for path in folder.glob("*"):
            if path.name not in kept:
                with suppress(OSError):
                    path.unlink(missing_ok=True)
        files.remove_if_empty(folder)

    def forget_all_of(self, is_gone: Callable[[str], bool]) -> None:
        """Remove what workers have left whose name says that they never come back: their room is others' again."""
        for folder in (self._folder / INCOMING).glob("*"):
            if is_gone(folder.name):
                rmtree(folder, ignore_errors=True)

    # ---- keeping and dropping ------------------------------------------------------------------------------------

    def flush(self, digests: Iterable[str]) -> None:
        """Have blobs that are kept on disk for good; raises Unavailable if the disk fails."""
        try:
            there = [path for path in map(self.path, digests) if path.exists()]
            for path in there:
                files.flush(path)
            for folder in {path.parent for path in there} | ({self._folder} if there else set()):
                files.flush(folder)
        except OSError as fault:
            raise Unavailable(f"blobs in {self._folder} cannot be flushed: {fault}") from fault

    def drop(self, digests: Iterable[str]) -> None:
        """Remove blobs nobody needs any more."""
        for digest in digests:
            with suppress(OSError):
                os.unlink(self._place(digest))

    def keep_only(self, wanted: frozenset[str]) -> None:
        """Remove what an interrupted commit left in the store; never what is wanted or not taken in yet."""
        for folder in self._folder.glob("[0-9a-f][0-9a-f]"):
            for path in folder.iterdir():
                if path.name not in wanted:
                    path.unlink(missing_ok=True)
        for folder in (self._folder / INCOMING).glob("*"):
            files.remove_if_empty(folder)

    def forget_all(self) -> None:
        """Remove all that workers have left: for a run that is over."""
        rmtree(self._folder / INCOMING, ignore_errors=True)

    # ---- who sees the same folder --------------------------------------------------------------------------------

    def make_probe(self) -> str:
        """Write what a worker must read in the file `probe` to know that it sees this folder; returns it.

        Raises:
            Unavailable: the disk does not take it.
        """
        self._probe = self._probe or secrets.token_hex(16)
        files.write_whole(self._folder / PROBE, self._probe.encode(), self.within)
        return self._probe


class WorkerFolder:
    """A worker's end of a store in a folder it can see. See `contract.blobs.Blobs`."""

    def __init__(self, run_dir: Path, worker: str) -> None:
        self._store = BlobFolder(run_dir)
        self._incoming = self._store.incoming(worker)
        self._quota = self._store.quota()

    @staticmethod
    def sees(run_dir: Path, worker: str, probe: str) -> bool:
        """Return whether the store the books told `probe` of is the one in this folder, and can be written."""
        store = BlobFolder(run_dir)
        folder = store.incoming(worker)
        try:
            if (run_dir / BLOBS / PROBE).read_text() != probe:
                return False
            files.write_whole(folder / PROBE, probe.encode(), store.within)
            (folder / PROBE).unlink()
        except (OSError, ValueError, Unavailable):
            return False
        return True

    def put(self, data: bytes) -> BlobRef:
        """See `Blobs.put`."""
        ref = ref_of(data)
        if words := self._quota.excess(self._incoming.name, ref.size_bytes):
            raise Unavailable(words)
        files.write_whole(self._incoming / ref.digest, data, self._store.within)
        return ref

    def get(self, ref: BlobRef) -> bytes:
        """See `Blobs.get`."""
        return self._store.get(ref)
