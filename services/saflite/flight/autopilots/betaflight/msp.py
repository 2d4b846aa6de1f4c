"""MultiWii Serial Protocol, versions 1 and 2: frames made and answers read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

PAYLOAD_V1_MAX, COMMAND_V1_MAX, PAYLOAD_V2_MAX = 255, 254, 65_535
BOX_IDS, SET_RAW_RC = 119, 200


class Answer(NamedTuple):
    """An answer: the command it is to, what it holds, whether the firmware took the command."""

    command: int
    payload: bytes
    taken: bool


def frame(command: int, payload: bytes = b"", version: int = 1) -> bytes:
    """Return a request; a version 2 frame has the longer command and payload."""
    if version == 1:
        body = bytes((len(payload) & 255, command & 255)) + payload
        return b"$M<" + body + bytes((_xor(body),))
    body = b"\0" + command.to_bytes(2, "little") + len(payload).to_bytes(2, "little") + payload
    return b"$X<" + body + bytes((_crc(body),))


def answers(said: bytes) -> Iterator[Answer]:
    """Yield the whole answers in what a port has said."""
    at = 0
    while (at := said.find(b"$", at)) >= 0:
        answer, size = _answer(said[at:])
        if answer is not None:
            yield answer
        at += max(1, size)


def _answer(said: bytes) -> tuple[Answer | None, int]:
    kind, direction = said[:2], said[2:3]
    if direction not in (b">", b"!"):
        return None, 1
    if kind == b"$M" and len(said) >= 6:
        size, end = 6 + said[3], 5 + said[3]
        whole = len(said) >= size and _xor(said[3:end]) == said[end]
        return (Answer(said[4], said[5:end], direction == b">"), size) if whole else (None, 1)
    if kind == b"$X" and len(said) >= 9:
        end = 8 + int.from_bytes(said[6:8], "little")
        whole = len(said) > end and _crc(said[3:end]) == said[end]
        command = int.from_bytes(said[4:6], "little")
        return (Answer(command, said[8:end], direction == b">"), end + 1) if whole else (None, 1)
    return None, 1


def _xor(data: bytes) -> int:
    total = 0
    for byte in data:
        total ^= byte
    return total


def _crc(data: bytes) -> int:
    """Return the CRC-8/DVB-S2 of data."""
    total = 0
    for byte in data:
        total ^= byte
        for _ in range(8):
            total = (total << 1 ^ 0xD5) & 255 if total & 128 else total << 1
    return total
