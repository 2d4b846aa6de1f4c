"""The store of blobs in memory: what workers leave, what the books have adopted. Survives both."""

from __future__ import annotations

from collections.abc import Iterable

from saflite.contract.blobs import BlobMissing, BlobRef, ref_of
from saflite.contract.ids import digest


class FarmBlobs:
    """Has the face of `evidence.folder.BlobFolder` that the service around the books uses."""

    def __init__(self) -> None:
        self.kept: dict[str, bytes] = {}
        self.lost: set[str] = set()  # by the world: one that was judged before may be wanted all the same
        self.left: dict[tuple[str, str], bytes] = {}

    def put(self, data: bytes) -> BlobRef:
        """See `BlobFolder.put`."""
        ref = ref_of(data)
        self.kept[ref.digest] = data
        return ref

    def get(self, ref: BlobRef) -> bytes:
        """See `BlobFolder.get`."""
        if fault := self.fault(ref, deep=True):
            raise BlobMissing(ref, f"is {fault}")
        return self.kept[ref.digest]

    def fault(self, ref: BlobRef, *, deep: bool = False) -> str:
        """See `BlobFolder.fault`."""
        if ref.digest not in self.kept:
            return "missing"
        data = self.kept[ref.digest]
        whole = len(data) == ref.size_bytes and (not deep or digest(data) == ref.digest)
        return "" if whole else "damaged"

    def adopt(self, worker: str, ref: BlobRef) -> str:
        """See `BlobFolder.adopt`."""
        data = self.left.get((worker, ref.digest))
        if data is not None and ref_of(data) == ref:
            self.kept[ref.digest] = data
        return self.fault(ref, deep=True)

    def forget(self, worker: str, digests: Iterable[str]) -> None:
        """See `BlobFolder.forget`."""
        for name in digests:
            self.left.pop((worker, name), None)

    def forget_but(self, worker: str, keep: Iterable[str]) -> None:
        """See `BlobFolder.forget_but`."""
        kept = set(keep)
        self.left = {key: data for key, data in self.left.items() if key[0] != worker or key[1] in kept}

    def drop(self, digests: Iterable[str]) -> None:
        """See `BlobFolder.drop`."""
        for name in digests:
            self.kept.pop(name, None)

    def keep_only(self, wanted: frozenset[str]) -> None:
        """See `BlobFolder.keep_only`."""
        self.kept = {name: data for name, data in self.kept.items() if name in wanted}


class FarmWorkerBlobs:
    """A worker's end of it."""

    def __init__(self, blobs: FarmBlobs, worker: str) -> None:
        self._blobs, self._worker = blobs, worker

    def put(self, data: bytes) -> BlobRef:
        """See `Blobs.put`."""
        ref = ref_of(data)
        self._blobs.left[self._worker, ref.digest] = data
        return ref

    def get(self, ref: BlobRef) -> bytes:
        """See `Blobs.get`."""
        return self._blobs.get(ref)
