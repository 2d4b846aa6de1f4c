"""Blobs in memory: for one process, where nothing has to outlive it."""

from __future__ import annotations

from saflite.contract.blobs import BlobMissing, BlobRef, check_ref, ref_of
from saflite.contract.ids import digest


class MemoryBlobs:
    """See `contract.blobs.Blobs`."""

    def __init__(self) -> None:
        self.kept: dict[str, bytes] = {}

    def put(self, data: bytes) -> BlobRef:
        """See `Blobs.put`."""
        ref = ref_of(data)
        self.kept[ref.digest] = data
        return ref

    def get(self, ref: BlobRef) -> bytes:
        """See `Blobs.get`."""
        check_ref(ref)
        data = self.kept.get(ref.digest)
        if data is None:
            raise BlobMissing(ref, "is missing")
        if digest(data) != ref.digest:
            raise BlobMissing(ref, "is damaged")
        return data
