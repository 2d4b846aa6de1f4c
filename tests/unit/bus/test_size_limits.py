"""Bounds of the router on sizes: the longest legal message passes, and every question has a bound."""

from __future__ import annotations

import msgspec
import pytest

from saflite.bus.access import SEAL_BYTES_MAX, size_limits
from saflite.contract import topics, wire
from saflite.contract.blobs import CHUNK_BYTES_MAX, BlobOpen, BlobPut, BlobRef
from saflite.contract.bounds import ITEMS_MAX
from saflite.contract.join import Join
from saflite.contract.work import TARGETS_MAX, Heartbeat, TargetBuild

LONGEST: list[tuple[str, msgspec.Struct]] = [
    (
        topics.blob("night", "put"),
        BlobPut(worker="w" * 64, ref=BlobRef(digest="a" * 64, size_bytes=2**28), data=bytes(CHUNK_BYTES_MAX)),
    ),
    (topics.blob("night", "open"), BlobOpen(worker="w" * 64, keep=("a" * 64,) * ITEMS_MAX)),
    (
        topics.beat("night", "fly"),
        Heartbeat(worker="w" * 64, stage="fly", leases=(("l" * 64, 2**40),) * 1_000),
    ),
    (
        topics.join("night", "fly"),
        Join(
            protocol=2,
            targets=(TargetBuild("t" * 64, "b" * 64),) * TARGETS_MAX,
            modules={f"{number:0200d}": "m" * 200 for number in range(64)},
            labels={f"{number:0200d}": "l" * 200 for number in range(64)},
        ),
    ),
]


@pytest.mark.parametrize(("key", "message"), LONGEST, ids=[key for key, _ in LONGEST])
def test_the_longest_legal_message_passes(key: str, message: msgspec.Struct) -> None:
    data = wire.encode(message)
    assert wire.decode(data, type(message)) == message
    assert len(data) <= topics.bytes_max(key) < wire.MESSAGE_BYTES_MAX


def test_every_question_has_a_bound_with_and_without_a_proven_name() -> None:
    limits = {key: limit["size_limit"] for limit in size_limits() for key in limit["key_exprs"]}
    assert (
        limits["saflite/2/*/blob/put"]
        == limits["by/*/saflite/2/*/blob/put"]
        == SEAL_BYTES_MAX + CHUNK_BYTES_MAX + 2**16
    )
    assert limits["saflite/join/*/*"] == SEAL_BYTES_MAX + 2**20
    assert sum(key.startswith("by/") for key in limits) == sum(topic.answer is not None for topic in topics.TOPICS)
    assert limits["**"] == wire.MESSAGE_BYTES_MAX + SEAL_BYTES_MAX
