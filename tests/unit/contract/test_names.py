"""Names in messages: what is none never gets past the decoder, so it cannot become a path, a key or a line."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from saflite.contract import topics, wire
from saflite.contract.blobs import BlobGet, BlobPut, BlobRef
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.names import is_name, recording_file
from saflite.contract.score import Score
from saflite.contract.verdict import Judgement, Verdict, Violation
from saflite.contract.work import Ask, Heartbeat, RecordResult, Report

ID, DIGEST = "0123456789abcdef", "ab" * 32
REF = {"digest": DIGEST, "size_bytes": 1}
EVIL = ["../../x", "/etc/passwd", "a/b", "..", "x\n", "\x1b[2J", "[red]", "\u202e", "*", "**", "$*", "a b", "é"]

GOOD: list[tuple[type[msgspec.Struct], dict[str, Any], tuple[str, ...]]] = [
    (Ask, {"worker": "fly-1", "stage": "fly", "session": "s"}, ("worker", "session")),
    (Heartbeat, {"worker": "fly-1", "stage": "fly", "session": "s"}, ("worker", "session")),
    (Report, {"worker": "w", "lease_id": "l", "epoch": 1, "result": {"type": "failed", "message": ""}}, ("worker",)),
    (BlobRef, REF, ("digest",)),
    (BlobGet, {"digest": DIGEST, "offset": 0}, ("digest",)),
    (BlobPut, {"worker": "w", "ref": REF}, ("worker",)),
    (
        Flight,
        {"test_case": ID, "flight_index": 0, "ending": "lost", "trace_digest": DIGEST, "worker": "w"},
        ("test_case", "trace_digest", "worker"),
    ),
    (RecordResult, {"type": "recorded", "test_case": ID, "flight_index": 0, "blob": REF}, ("test_case",)),
    (Verdict, {"policy": "min-obstacle-distance", "outcome": "inconclusive"}, ("policy",)),
    (Judgement, {"test_case": ID, "flight_index": 0, "verdicts": [], "fingerprint": ID}, ("test_case", "fingerprint")),
    (Score, {"test_case": ID, "value": 1.0, "model": "openai:m@http://h:1/v1", "scored_by": "gap"}, ("test_case",)),
    (
        Violation,
        {
            "fingerprint": ID,
            "test_case": ID,
            "policy": "p",
            "robustness": -1.0,
            "severity": "hard",
            "confirmation": "confirmed",
        },
        ("fingerprint", "test_case", "policy"),
    ),
]


@pytest.mark.parametrize(("kind", "content", "names"), GOOD, ids=lambda value: getattr(value, "__name__", ""))
def test_a_message_with_a_name_that_is_none_is_refused(
    kind: type[msgspec.Struct], content: dict[str, Any], names: tuple[str, ...]
) -> None:
    wire.decode(msgspec.msgpack.encode(content), kind)
    for name in names:
        for evil in (*EVIL, content[name] + "\n", content[name] + 70 * "0"):
            with pytest.raises(Refused, match=name):
                wire.decode(msgspec.msgpack.encode({**content, name: evil}), kind)


@pytest.mark.parametrize("evil", [*EVIL, "", "x" * 65, "-x", ".hidden"])
def test_what_is_no_name_is_no_campaign(evil: str) -> None:
    assert not is_name(evil)
    with pytest.raises(Refused):
        topics.prefix(evil)


@pytest.mark.parametrize("evil", [*EVIL, "", ID + "\n", ID.upper(), ID + "0"])
def test_a_recording_is_never_outside_its_folder(evil: str) -> None:
    assert recording_file(ID, 0) == f"recordings/{ID}-0.mcap"
    with pytest.raises(Refused):
        recording_file(evil, 0)
    with pytest.raises(Refused):
        recording_file(ID, -1)
