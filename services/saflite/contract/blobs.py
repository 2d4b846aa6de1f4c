"""Blobs: traces, artefacts and recordings as bytes beside the books, named by their digest.

A blob's digest is the SHA-256 of its bytes as they are stored and travel (compressed, if they are), so that any tool
can check a blob as it stands. That a flight repeated bit by bit is another matter: `Flight.trace_digest` is the digest
of the trace's content.

Whoever cannot see the folder of the run reads and writes blobs over the bus, in chunks: `BlobOpen` first, then
`BlobGet` and `BlobPut` as often as it takes. What is put waits under the worker's name until the books have taken a
result that names it.
"""

from __future__ import annotations

import re
from typing import Annotated, Protocol

import msgspec

from saflite.contract.bounds import ITEMS_MAX, Count, Place, Word
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.ids import digest
from saflite.contract.names import Digest, Name

BLOB_BYTES_MAX = 256 * 2**20
CHUNK_BYTES_MAX = 2**20
BLOBS_PER_RESULT_MAX = 64
RESULT_BYTES_MAX = 2 * BLOB_BYTES_MAX
"""All blobs of one result together."""

DIGEST_DIGITS = 64
_is_digest = re.compile(f"[0-9a-f]{{{DIGEST_DIGITS}}}").fullmatch


class BlobRef(msgspec.Struct, frozen=True, kw_only=True):
    """A blob named: SHA-256 of its bytes, in hexadecimal, and how many they are."""

    digest: Digest
    size_bytes: Count


class BlobMissing(Unavailable):
    """A blob that should be there is not, or its bytes are not those its digest names."""

    def __init__(self, ref: BlobRef, why: str) -> None:
        super().__init__(f"blob {ref.digest[:16]} ({ref.size_bytes} bytes) {why}")
        self.ref, self.why = ref, why


class Blobs(Protocol):
    """Where a worker leaves and finds blobs."""

    def put(self, data: bytes) -> BlobRef:
        """Leave a blob; it is there for whoever is handed the reference. Doing it twice is harmless.

        Raises:
            Refused: it is larger than `BLOB_BYTES_MAX`.
            Unavailable: the disk or the books do not take it.
        """
        ...

    def get(self, ref: BlobRef) -> bytes:
        """Return a blob, its digest checked.

        Raises:
            Refused: the reference cannot be one.
            BlobMissing: it is not there, or damaged.
            Unavailable: the books do not answer.
        """
        ...


def ref_of(data: bytes) -> BlobRef:
    """Return the reference of a blob; raises Refused if it is too large."""
    if len(data) > BLOB_BYTES_MAX:
        raise Refused("blob", expected=f"at most {BLOB_BYTES_MAX} bytes", got=f"{len(data)} bytes")
    return BlobRef(digest=digest(data), size_bytes=len(data))


def check_digest(digest: str) -> None:
    """Raise Refused unless this can be the digest of a blob: it becomes a path."""
    if not _is_digest(digest):
        raise Refused("blob", expected=f"a digest of {DIGEST_DIGITS} lower-case hexadecimal digits", got=digest[:80])


def check_ref(ref: BlobRef) -> None:
    """Raise Refused unless the reference can be one."""
    check_digest(ref.digest)
    if not 0 <= ref.size_bytes <= BLOB_BYTES_MAX:
        raise Refused("blob", expected=f"a size of 0 to {BLOB_BYTES_MAX} bytes", got=ref.size_bytes)


# ---- over the bus -------------------------------------------------------------------------------------------------


class BlobOpen(msgspec.Struct, frozen=True, kw_only=True):
    """Said once by a worker before it uses blobs: of what it left earlier, all but `keep` (digests) may go."""

    worker: Name
    keep: Annotated[tuple[Digest, ...], msgspec.Meta(max_length=ITEMS_MAX)] = ()


class BlobOpened(msgspec.Struct, frozen=True, kw_only=True):
    """What stands in the file `probe` of the store: a worker that reads the same there sees the same folder."""

    probe: Word


class BlobGet(msgspec.Struct, frozen=True, kw_only=True):
    """Asks for up to `length` bytes of a blob from `offset` on."""

    digest: Digest
    offset: Count
    length: Count = CHUNK_BYTES_MAX


class BlobChunk(msgspec.Struct, frozen=True, kw_only=True):
    """A stretch of a blob. `size_bytes` is that of the whole blob, -1 where there is none of that digest."""

    size_bytes: Place
    data: Annotated[bytes, msgspec.Meta(max_length=CHUNK_BYTES_MAX)] = b""


class BlobPut(msgspec.Struct, frozen=True, kw_only=True):
    """Leaves a stretch of a blob. Without data it only asks how much is there already."""

    worker: Name
    ref: BlobRef
    offset: Count = 0
    data: Annotated[bytes, msgspec.Meta(max_length=CHUNK_BYTES_MAX)] = b""


class BlobTaken(msgspec.Struct, frozen=True, kw_only=True):
    """How many bytes of the blob are there from its start: go on from here. All of them once its digest was checked."""

    have_bytes: Count
